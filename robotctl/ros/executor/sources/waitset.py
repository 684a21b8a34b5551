"""The slow path: one thread waits in a wait set for what has no callback in rcl.

That is guard conditions and foreign Waitables. The thread only waits; taking and executing
happen in the loop, while the thread stands still.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.signals import SignalHandlerGuardCondition

from robotctl.ros.executor.runtime import Runtime, log
from robotctl.ros.executor.sources.source import Source

SHUTDOWN_LOOK_S = 0.005
SHUTDOWN_LOOKS = 200
"""After a signal the context is looked at so often: a second in all."""


class WaitSetSource(Source):
    """An entity that is waited for in the thread."""

    path = "wait-set thread"

    def __init__(
        self, runtime: Runtime, entity: Any, handle: Any, where: str, thread: WaitSetThread
    ) -> None:
        super().__init__(runtime, entity, handle, where)
        self._thread = thread
        self.parked = False

    def attach(self) -> None:
        self.handle.__enter__()
        self._thread.add(self)

    def detach(self) -> None:
        if self.closed:
            return
        self.closed = True
        self._thread.remove(self)

    def release(self) -> None:
        """The thread waits for it no more: the entity may be destroyed."""
        self.handle.__exit__(None, None, None)

    def counts(self) -> tuple[int, int, int, int, int, int]:
        """How many subscriptions, guards, timers, clients, services and events it waits for."""
        raise NotImplementedError

    def fill(self, wait_set: Any) -> None:
        """Add them to a wait set."""
        raise NotImplementedError

    def fire(self, wait_set: Any) -> None:
        """In the loop: run the callback if the wait set says so."""
        raise NotImplementedError


class WaitSetThread:
    """One thread that waits; started with the first source, ended with the executor."""

    def __init__(
        self, runtime: Runtime, context: Context, on_context_down: Callable[[], None]
    ) -> None:
        self._runtime = runtime
        self._context = context
        self._on_context_down = on_context_down
        self._lock = threading.Lock()
        self._sources: dict[WaitSetSource, None] = {}
        self._retired: list[WaitSetSource] = []
        self._taken = threading.Semaphore(0)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._wake: GuardCondition | None = None
        self._signals: GuardCondition | None = None

    def watch_signals(self) -> None:
        """Notice when rclpy's own signal handlers shut the context down: nothing else tells."""
        self._signals = SignalHandlerGuardCondition(self._context)
        self._start()

    def add(self, source: WaitSetSource) -> None:
        """Wait for it too."""
        with self._lock:
            self._sources[source] = None
        self._start()
        self.refresh()

    def remove(self, source: WaitSetSource) -> None:
        """Wait for it no more; it is released when the thread has let go of it."""
        with self._lock:
            if source in self._sources:
                del self._sources[source]
                self._retired.append(source)
        self.refresh()

    def refresh(self) -> None:
        """Look again at what to wait for."""
        if self._wake is not None:
            self._wake.trigger()

    def stop(self) -> None:
        """End the thread and release every source."""
        self._stopping.set()
        self._taken.release()
        self.refresh()
        if self._thread is not None:
            self._thread.join()
        self._release(self._retired)
        self._release(list(self._sources))
        self._retired, self._sources = [], {}
        for guard in (self._wake, self._signals):
            if guard is not None:
                guard.destroy()
        self._wake = self._signals = None

    def _start(self) -> None:
        if self._thread is None:
            self._wake = GuardCondition(None, None, context=self._context)
            self._thread = threading.Thread(target=self._run, name="rcl wait set", daemon=True)
            self._thread.start()

    def _run(self) -> None:
        while not self._stopping.is_set():
            with self._lock:
                retired, self._retired = self._retired, []
                sources = [source for source in self._sources if not source.parked]
            self._release(retired)
            with ExitStack() as held:
                try:
                    wait_set = self._build(sources, held)
                    wait_set.wait(-1)
                except _rclpy.RCLError as error:
                    if self._context.ok():
                        log.error("the executor shuts down: its wait-set thread failed: %s", error)
                    self._post(self._on_context_down)
                    return
                if self._stopping.is_set():
                    return
                if not self._post(self._dispatch, wait_set, sources):
                    return
                self._taken.acquire()

    def _build(self, sources: list[WaitSetSource], held: ExitStack) -> Any:
        guards = [guard for guard in (self._wake, self._signals) if guard is not None]
        totals = [sum(column) for column in zip(*(s.counts() for s in sources), strict=True)]
        totals = totals or [0] * 6
        totals[1] += len(guards)
        assert self._context.handle is not None
        held.enter_context(self._context.handle)
        wait_set = _rclpy.WaitSet(*totals, self._context.handle)
        wait_set.clear_entities()
        for guard in guards:
            wait_set.add_guard_condition(guard.handle)
        for source in sources:
            # Destroyed since: its removal is on the way.
            with suppress(InvalidHandle):
                source.fill(wait_set)
        return wait_set

    def _dispatch(self, wait_set: Any, sources: list[WaitSetSource]) -> None:
        try:
            if self._signals is not None:
                pointers = wait_set.get_ready_entities("guard_condition")
                if self._signals.handle.pointer in pointers:
                    self._look_for_shutdown(SHUTDOWN_LOOKS)
            for source in sources:
                if self._runtime.stale:
                    self._runtime.sync()
                if not source.closed:
                    source.fire(wait_set)
        finally:
            self._taken.release()

    def _look_for_shutdown(self, looks: int) -> None:
        # rclpy's signal handler wakes us before it shuts the context down, and not again after.
        if not self._context.ok():
            self._on_context_down()
        elif looks and not self._stopping.is_set():
            self._runtime.loop.call_later(SHUTDOWN_LOOK_S, self._look_for_shutdown, looks - 1)

    def _post(self, callback: Callable[..., None], *args: Any) -> bool:
        try:
            self._runtime.loop.call_soon_threadsafe(callback, *args)
        except RuntimeError:  # The loop is closed: nobody is left to tell.
            return False
        return True

    @staticmethod
    def _release(sources: list[WaitSetSource]) -> None:
        for source in sources:
            source.release()
