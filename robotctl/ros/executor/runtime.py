"""What the sources of one executor share: loop, tasks, pools and exception handler."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any, Protocol

from rclpy.callback_groups import CallbackGroup

from robotctl.ros.executor.pool import Pool
from robotctl.ros.executor.slow_callbacks import SlowCallbacks, TimedSteps
from robotctl.ros.executor.time_limits import SHORTEST_SLICE_NS, SLICE_NS, TURN_NS

log = logging.getLogger("robotctl.ros.executor")

ExceptionHandler = Callable[[Exception, str], None]
"""Called with each exception that a callback raises, and a text that names the callback."""


class Resumable(Protocol):
    """A source that waits for its callback group."""

    def resume(self) -> None:
        """Deliver again what is there."""


class Runtime:
    """The state that one executor shares with its sources; used in the loop's thread only."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sync: Callable[[], None],
        on_exception: ExceptionHandler | None,
    ) -> None:
        self.loop = loop
        self.sync = sync
        self.stale = False
        """Whether an entity was created or destroyed, so that `sync` must precede a callback."""
        self.tasks: set[asyncio.Task[None]] = set()
        self.slow = SlowCallbacks()
        self.slice_ns = SLICE_NS
        self.flooded: set[object] = set()
        """The sources whose last slice ended before all was delivered."""
        self._pools: dict[float, Pool] = {}
        self._on_exception = on_exception
        self._on_idle: Callable[[], None] | None = None
        self._parked: dict[CallbackGroup, dict[Resumable, None]] = {}

    def report(self, error: Exception, where: str) -> None:
        """Pass the exception of a callback to the exception handler."""
        if self._on_exception is not None:
            try:
                self._on_exception(error, where)
            except Exception as second:  # noqa: BLE001 - reported below
                second.__context__ = error
                error, where = second, f"exception handler, for {where}"
            else:
                return
        self.loop.call_exception_handler(
            {"message": f"exception in the callback of {where}", "exception": error}
        )

    def pool(self, rest_s: float) -> Pool:
        """Return the pool of the sources that may wait `rest_s` seconds."""
        if rest_s not in self._pools:
            self._pools[rest_s] = Pool(self.loop, rest_s)
        return self._pools[rest_s]

    def close_pools(self) -> None:
        """Close the file descriptors of the pools; all sources must be detached."""
        for pool in self._pools.values():
            pool.close()
        self._pools.clear()

    def mark_flooded(self, source: object) -> None:
        """Share a turn of the loop between this source and the other flooded ones."""
        if source not in self.flooded:
            self.flooded.add(source)
            self._share_turn()

    def mark_drained(self, source: object) -> None:
        """Note that the source has nothing left: it is not flooded."""
        if source in self.flooded:
            self.flooded.remove(source)
            self._share_turn()

    def _share_turn(self) -> None:
        share_ns = TURN_NS // max(len(self.flooded), 1)
        self.slice_ns = max(SHORTEST_SLICE_NS, min(SLICE_NS, share_ns))

    def spawn(
        self,
        coroutine: Coroutine[Any, Any, Any],
        where: str,
        finished: Callable[[], None] | None = None,
    ) -> asyncio.Task[None]:
        """Run an async callback as a task; call `finished` when it ends in any way."""

        async def run() -> None:
            try:
                await TimedSteps(coroutine, where, self.slow)
            except Exception as error:  # noqa: BLE001 - handed to the one handler
                self.report(error, where)

        def end(task: asyncio.Task[None]) -> None:
            self.tasks.discard(task)
            # Otherwise, if cancelled before its first step, it warns that it was never awaited.
            coroutine.close()
            if finished is not None:
                finished()
            if self._on_idle is not None:
                self.on_idle(self._on_idle)

        task = self.loop.create_task(run(), name=where)
        self.tasks.add(task)
        task.add_done_callback(end)
        return task

    def on_idle(self, callback: Callable[[], None]) -> None:
        """Call `callback` when no task runs any more, at once if none does."""
        self._on_idle = callback
        if not self.tasks:
            callback()

    def park(self, group: CallbackGroup, source: Resumable) -> None:
        """Resume the source when its callback group becomes free."""
        self._parked.setdefault(group, {})[source] = None

    def release(self, group: CallbackGroup) -> None:
        """Resume the parked sources of a callback group that became free."""
        for source in self._parked.pop(group, ()):
            source.resume()


def name_of(callback: Any) -> str:
    """Return the name of a callback for the log."""
    name = getattr(callback, "__qualname__", None)
    return name if isinstance(name, str) else repr(callback)
