"""What the sources of one executor share: its loop, its tasks, its one exception handler."""

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
"""Told about every exception of a callback: the exception, and whose callback raised it."""


class Resumable(Protocol):
    """Waits for its callback group to become free."""

    def resume(self) -> None:
        """Look for work again."""


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
        """An entity was created or destroyed: call `sync` before the next callback."""
        self.tasks: set[asyncio.Task[None]] = set()
        self.slow = SlowCallbacks()
        self.slice_ns = SLICE_NS
        self._flooded: set[object] = set()
        self._pools: dict[float, Pool] = {}
        self._on_exception = on_exception
        self._on_idle: Callable[[], None] | None = None
        self._parked: dict[CallbackGroup, dict[Resumable, None]] = {}

    def report(self, error: Exception, where: str) -> None:
        """Hand the exception of a callback to the one handler."""
        if self._on_exception is not None:
            try:
                self._on_exception(error, where)
            except Exception as second:  # noqa: BLE001 - reported below, with its cause
                second.__context__ = error
                error, where = second, f"exception handler, for {where}"
            else:
                return
        self.loop.call_exception_handler(
            {"message": f"exception in the callback of {where}", "exception": error}
        )

    def pool(self, rest_s: float) -> Pool:
        """The pool of all sources that may wait so long."""
        if rest_s not in self._pools:
            self._pools[rest_s] = Pool(self.loop, rest_s)
        return self._pools[rest_s]

    def close_pools(self) -> None:
        """Give the descriptors of the pools back, once no source is in them."""
        for pool in self._pools.values():
            pool.close()
        self._pools.clear()

    def flooded(self, source: object) -> None:
        """The source had more than its slice allowed: from now on it shares a turn with others."""
        if source not in self._flooded:
            self._flooded.add(source)
            self._share_turn()

    def drained(self, source: object) -> None:
        """The source has nothing left."""
        if source in self._flooded:
            self._flooded.remove(source)
            self._share_turn()

    def _share_turn(self) -> None:
        share_ns = TURN_NS // max(len(self._flooded), 1)
        self.slice_ns = max(SHORTEST_SLICE_NS, min(SLICE_NS, share_ns))

    def spawn(
        self,
        coroutine: Coroutine[Any, Any, Any],
        where: str,
        finished: Callable[[], None] | None = None,
    ) -> asyncio.Task[None]:
        """Run an async callback as a task of its own; `finished` is called however it ends."""

        async def run() -> None:
            try:
                await TimedSteps(coroutine, where, self.slow)
            except Exception as error:  # noqa: BLE001 - handed to the one handler
                self.report(error, where)

        def end(task: asyncio.Task[None]) -> None:
            self.tasks.discard(task)
            # Cancelled before its first step, it would warn about never having been awaited.
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
        """Call back when no task runs any more, which may be at once."""
        self._on_idle = callback
        if not self.tasks:
            callback()

    def park(self, group: CallbackGroup, source: Resumable) -> None:
        """Resume the source when the group becomes free."""
        self._parked.setdefault(group, {})[source] = None

    def release(self, group: CallbackGroup) -> None:
        """The group became free: its parked sources look for work again."""
        for source in self._parked.pop(group, ()):
            source.resume()


def name_of(callback: Any) -> str:
    """What a log calls a callback."""
    name = getattr(callback, "__qualname__", None)
    return name if isinstance(name, str) else repr(callback)
