"""The part of an executor that exists only while it is open."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

from robotctl.ros.executor import futures
from robotctl.ros.executor.entities import Attachments
from robotctl.ros.executor.loop_thread import LoopThread
from robotctl.ros.executor.nodes import Nodes
from robotctl.ros.executor.realtime import FifoScheduling
from robotctl.ros.executor.runtime import ExceptionHandler, Runtime, log
from robotctl.ros.executor.sources.waitset import WaitSetThread


class Engine:
    """Keeps one source attached for each entity of the nodes, and schedules the loop's thread.

    `wake` and `request_close` may be called from any thread, the rest in the loop's thread only.
    """

    def __init__(
        self,
        executor: Any,
        loop: asyncio.AbstractEventLoop,
        loop_thread: LoopThread,
        nodes: Nodes,
        close: Callable[[], None],
        on_exception: ExceptionHandler | None,
    ) -> None:
        """Prepare to run callbacks in `loop`; `close` closes the executor, in the loop."""
        self.runtime = Runtime(loop, self.sync, on_exception)
        self._loop_thread = loop_thread
        self._context: Context = executor.context
        self._nodes = nodes
        self._close = close
        self._wait_set = WaitSetThread(self.runtime, self._context, close)
        self.attachments = Attachments(self.runtime, self._wait_set, executor)
        self._fifo: FifoScheduling | None = None
        self._sync_scheduled = False
        self._closing = False

    @property
    def scheduling(self) -> str:
        """How the operating system schedules the loop's thread, in words."""
        return "SCHED_OTHER" if self._fifo is None else self._fifo.description

    def open(self, fifo_priority: int | None) -> None:
        """Attach the entities of the nodes, and watch for the shutdown of the context."""
        futures.open_bridge(self.runtime.loop)
        if fifo_priority is not None:
            self._fifo = FifoScheduling(fifo_priority)
            log.info("the loop's thread runs under %s", self._fifo.description)
        self._context.on_shutdown(self._on_context_shutdown)
        if get_current_signal_handlers_options() != SignalHandlerOptions.NO:
            self._wait_set.watch_signals()
        self.sync()

    def wake(self) -> None:
        """Look for created and destroyed entities in the next turn of the loop."""
        if self._closing:
            return
        self.runtime.stale = True
        if not self._loop_thread.is_current():
            with suppress(RuntimeError):  # The loop is closed: there is nothing to look for.
                self.runtime.loop.call_soon_threadsafe(self._sync_if_stale)
        elif not self._sync_scheduled:
            self._sync_scheduled = True
            self.runtime.loop.call_soon(self._sync_if_stale)

    def sync(self) -> None:
        """Attach new entities of the nodes, detach destroyed ones."""
        if self._closing:
            self._close()
            return
        self.runtime.stale = False
        self.attachments.follow(self._nodes.entities())

    def request_close(self) -> None:
        """Begin no more callbacks, and close the executor in the loop."""
        self._closing = True
        self.runtime.stale = True
        # Not at once: a signal handler may interrupt code that uses what is released.
        self.runtime.loop.call_soon_threadsafe(self._close)

    def close(self, finished: Callable[[], None]) -> None:
        """Detach all entities and cancel all tasks; `finished` is called after the last task."""
        self._closing = True
        self.attachments.detach_all()
        self._wait_set.stop()
        self.runtime.close_pools()
        futures.close_bridge(self.runtime.loop)
        if self._fifo is not None:
            self._fifo.restore()
        for task in self.runtime.tasks:
            task.cancel()
        self.runtime.on_idle(finished)

    def _sync_if_stale(self) -> None:
        self._sync_scheduled = False
        if self.runtime.stale:
            self.sync()

    def _on_context_shutdown(self) -> None:
        # Runs in any thread, with the context's lock held: only schedule the rest.
        if not self._closing:
            with suppress(RuntimeError):  # The loop is closed: there is nothing to release.
                self._loop_thread.call_soon(self._close)
