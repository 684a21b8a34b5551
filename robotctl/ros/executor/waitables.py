"""Guard conditions and foreign Waitables, for which a thread waits in a wait set."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.signals import SignalHandlerGuardCondition
from rclpy.waitable import Waitable

from robotctl.ros.executor.runtime import Runtime, log
from robotctl.ros.executor.source import RETRY_AFTER_FAILED_TAKE_S, Source

SHUTDOWN_POLL_S = 0.005
SHUTDOWN_POLLS = 200
"""The number of checks, after a signal, for a shutdown of the context: 1 s in all."""


class WaitSetSource(Source):
    """The base class of sources without an eventfd. `WaitSetThread` waits for their entities."""

    woken_by = "wait-set thread"

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

    @abstractmethod
    def counts(self) -> tuple[int, int, int, int, int, int]:
        """Return the entity's counts: subscriptions, guards, timers, clients, services, events."""

    @abstractmethod
    def fill(self, wait_set: Any) -> None:
        """Add the entity to a wait set."""

    @abstractmethod
    def run_if_ready(self, wait_set: Any) -> None:
        """Run the callback if the wait set shows the entity as ready. Called in the loop."""


class WaitSetThread:
    """The thread that waits for each `WaitSetSource` of an executor."""

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
        """Close the executor when a signal handler of rclpy shuts the context down."""
        self._signals = SignalHandlerGuardCondition(self._context)
        self._start()

    def add(self, source: WaitSetSource) -> None:
        """Begin to wait for the entity of a `WaitSetSource`."""
        with self._lock:
            self._sources[source] = None
        self._start()
        self.refresh()

    def remove(self, source: WaitSetSource) -> None:
        """Stop waiting for an entity, and release it when the thread no longer uses it."""
        with self._lock:
            if source in self._sources:
                del self._sources[source]
                self._retired.append(source)
        self.refresh()

    def refresh(self) -> None:
        """Make the thread build its wait set again."""
        if self._wake is not None:
            self._wake.trigger()

    def stop(self) -> None:
        """End the thread and release every entity."""
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
                if self._stopping.is_set() or not self._post(self._dispatch, wait_set, sources):
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
            # InvalidHandle: the entity was destroyed; its source is removed soon.
            with suppress(InvalidHandle):
                source.fill(wait_set)
        return wait_set

    def _dispatch(self, wait_set: Any, sources: list[WaitSetSource]) -> None:
        try:
            if self._signals is not None:
                pointers = wait_set.get_ready_entities("guard_condition")
                if self._signals.handle.pointer in pointers:
                    self._poll_shutdown(SHUTDOWN_POLLS)
            for source in sources:
                if self._runtime.stale:
                    self._runtime.sync()
                if not source.closed:
                    source.run_if_ready(wait_set)
        finally:
            self._taken.release()

    def _poll_shutdown(self, polls: int) -> None:
        # rclpy's signal handler wakes the thread before it shuts the context down, not after.
        if not self._context.ok():
            self._on_context_down()
        elif polls and not self._stopping.is_set():
            self._runtime.loop.call_later(SHUTDOWN_POLL_S, self._poll_shutdown, polls - 1)

    def _post(self, callback: Callable[..., None], *args: Any) -> bool:
        try:
            self._runtime.loop.call_soon_threadsafe(callback, *args)
        except RuntimeError:  # The loop is closed: nothing handles it.
            return False
        return True

    @staticmethod
    def _release(sources: list[WaitSetSource]) -> None:
        """Allow rclpy to destroy the entities of `sources`."""
        for source in sources:
            source.handle.__exit__(None, None, None)


class GuardSource(WaitSetSource):
    """Runs the callback of a guard condition when the guard condition is triggered."""

    _triggered = False

    def counts(self) -> tuple[int, int, int, int, int, int]:
        return (0, 1, 0, 0, 0, 0)

    def fill(self, wait_set: Any) -> None:
        wait_set.add_guard_condition(self.handle)

    def run_if_ready(self, wait_set: Any) -> None:
        if self.handle.pointer in wait_set.get_ready_entities("guard_condition"):
            self._call()

    def resume(self) -> None:
        # The wait has reset the guard condition, so rcl no longer knows that it was triggered.
        if self._triggered and not self.closed:
            self._call()

    def _call(self) -> None:
        if self.entity.callback is not None:
            self._triggered = self.blocked() or not self.run_callback(self.entity.callback)


class WaitableSource(WaitSetSource):
    """Runs the callbacks of a Waitable whose class is not rclpy's."""

    def __init__(
        self,
        runtime: Runtime,
        waitable: Waitable,
        where: str,
        thread: WaitSetThread,
        executor: Any,
    ) -> None:
        super().__init__(runtime, waitable, waitable, where, thread)
        self._executor = executor
        self._ready = False

    def counts(self) -> tuple[int, int, int, int, int, int]:
        try:
            number = self.entity.get_num_entities()
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._fail_in_thread(error)
            return (0, 0, 0, 0, 0, 0)
        return (
            number.num_subscriptions,
            number.num_guard_conditions,
            number.num_timers,
            number.num_clients,
            number.num_services,
            number.num_events,
        )

    def fill(self, wait_set: Any) -> None:
        if self.parked:
            return
        try:
            self.entity.add_to_wait_set(wait_set)
        except InvalidHandle:
            raise
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._fail_in_thread(error)

    def run_if_ready(self, wait_set: Any) -> None:
        if self.parked:
            return
        try:
            self._ready = self.entity.is_ready(wait_set)
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._retry_later(error)
        if self._ready:
            self._execute()

    def resume(self) -> None:
        if self._ready and not self.closed:
            self._execute()

    def _execute(self) -> None:
        # While parked it may stay ready; if the thread waited for it, the thread would be busy.
        self.parked = self.blocked()
        if self.parked:
            return
        self._ready = False
        waitable = self.entity
        try:
            data = waitable.take_data()
            for future in waitable._futures:
                future._set_executor(self._executor)
            self.run_async(waitable.execute(data))
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._retry_later(error)
        self._thread.refresh()

    def _fail_in_thread(self, error: Exception) -> None:
        self.parked = True
        with suppress(RuntimeError):  # The loop is closed: nothing handles the error.
            self.runtime.loop.call_soon_threadsafe(self._retry_later, error)

    def _retry_later(self, error: Exception) -> None:
        self.runtime.report(error, self.where)
        # A Waitable that stays ready would keep the thread busy.
        self.parked = True
        self.runtime.loop.call_later(RETRY_AFTER_FAILED_TAKE_S, self._retry)

    def _retry(self) -> None:
        self.parked = False
        if not self.closed:
            self._thread.refresh()
