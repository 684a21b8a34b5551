"""The state that the sources of one executor share."""

from __future__ import annotations

import asyncio
import logging
import select
import time
from asyncio import AbstractEventLoop, TimerHandle
from collections import Counter
from collections.abc import Callable, Coroutine, Generator
from typing import Any, Protocol

from rclpy.callback_groups import CallbackGroup

from robotctl.ros.executor.event_loop import (
    BEAT_NS,
    FLOOD_REST_S,
    FLOODED_SHARE,
    NS_PER_S,
    SHORTEST_SLICE_NS,
    SLICE_NS,
    SLOW_CALLBACK_NS,
    SLOW_WARNING_PAUSE_NS,
    TURN_NS,
    beat_before,
    unwatch,
    watch,
)


class Resumable(Protocol):
    """A `Source` that waits until its callback group is free."""

    def resume(self) -> None:
        """Continue to deliver."""


class Pooled(Protocol):
    """The member of a `Pool`: a `Source`, which runs the callback of one ROS entity."""

    def poll(self) -> bool:
        """Deliver the waiting data. Return True if the time slice ended with data left."""


class Pool:
    """Polls its `Source`s when data arrive, and rests for `rest_s` seconds after each poll."""

    def __init__(self, loop: AbstractEventLoop, rest_s: float) -> None:
        self._loop = loop
        self._rest_s = rest_s
        self._busy_ns = self._rested_ns = 0
        self._epoll = select.epoll()
        self._members: dict[int, Pooled] = {}
        self._resting: TimerHandle | None = None
        self._watching = False
        self._watch()

    def add(self, fd: int, source: Pooled) -> None:
        """Poll `source` when its eventfd `fd` becomes readable."""
        self._members[fd] = source
        self._epoll.register(fd, select.EPOLLIN)

    def remove(self, fd: int) -> None:
        """Stop polling the source of `fd`, which must still be open."""
        del self._members[fd]
        self._epoll.unregister(fd)

    def close(self) -> None:
        """Stop polling, and close the epoll."""
        self._unwatch()
        if self._resting is not None:
            self._resting.cancel()
            self._resting = None
        self._epoll.close()

    def _watch(self) -> None:
        if not self._watching:
            self._watching = True
            watch(self._loop, self._epoll.fileno(), self._poll)

    def _unwatch(self) -> None:
        if self._watching:
            self._watching = False
            unwatch(self._loop, self._epoll.fileno())

    def _poll(self) -> None:
        self._resting = None
        if self._epoll.closed:
            return
        ready = self._epoll.poll(0, len(self._members) or 1)
        if not ready:
            self._watch()
            return
        self._unwatch()
        begun_ns = time.monotonic_ns()
        left = True  # Also after an exception: the other sources continue.
        try:
            left = self._poll_ready(ready, begun_ns + TURN_NS)
        finally:
            if not self._epoll.closed:
                rest_s = self._rest_after(begun_ns, left=left)
                self._resting = self._loop.call_at(rested_s(rest_s), self._poll)

    def _rest_after(self, begun_ns: int, *, left: bool) -> float:
        """Return the time to rest [s], which is 0 if data are `left`."""
        now_ns = time.monotonic_ns()
        self._busy_ns += now_ns - begun_ns
        if left:
            return 0.0
        flooded = self._busy_ns > FLOODED_SHARE * (now_ns - self._rested_ns)
        self._busy_ns, self._rested_ns = 0, now_ns
        return min(self._rest_s, FLOOD_REST_S) if flooded else self._rest_s

    def _poll_ready(self, ready: list[tuple[int, int]], end: int) -> bool:
        left = False
        for fd, _ in ready:
            source = self._members.get(fd)
            if source is not None:
                left |= source.poll()
            if self._epoll.closed:
                return False
            if time.monotonic_ns() > end:
                return True
        return left


def rested_s(rest_s: float) -> float:
    """Return the monotonic time [s] at which a rest of `rest_s` from now ends.

    A rest longer than BEAT_NS ends early, on a beat, so that timers and rests end together.
    """
    until_ns = time.monotonic_ns() + round(rest_s * NS_PER_S)
    if rest_s * NS_PER_S > BEAT_NS:
        until_ns = beat_before(until_ns)
    return until_ns / NS_PER_S


log = logging.getLogger("robotctl.ros.executor")


class SlowCallbacks:
    """Warns about callbacks that block the loop, each at most once per SLOW_WARNING_PAUSE_NS."""

    def __init__(self) -> None:
        self._quiet_until_ns: dict[str, int] = {}
        self._unsaid: Counter[str] = Counter()

    def check(self, where: str, elapsed_ns: int) -> None:
        """Warn if the callback named `where` blocked the loop for more than SLOW_CALLBACK_NS."""
        if elapsed_ns <= SLOW_CALLBACK_NS:
            return
        now = time.monotonic_ns()
        if now < self._quiet_until_ns.get(where, 0):
            self._unsaid[where] += 1
            return
        for name in [name for name, until in self._quiet_until_ns.items() if until < now]:
            del self._quiet_until_ns[name]
        self._quiet_until_ns[where] = now + SLOW_WARNING_PAUSE_NS
        unsaid = self._unsaid.pop(where, 0)
        log.warning(
            "the callback of %s held the loop for %.0f ms%s; everything else waited. "
            "Make it async, or run the long part with asyncio.to_thread",
            where,
            elapsed_ns / 1e6,
            f" (and {unsaid} times since the last warning)" if unsaid else "",
        )


class TimedSteps:
    """Awaits a coroutine, and warns if one of its steps blocks the loop for too long."""

    __slots__ = ("_coroutine", "_slow", "_where")

    def __init__(
        self, coroutine: Coroutine[Any, Any, Any], where: str, slow: SlowCallbacks
    ) -> None:
        self._coroutine = coroutine
        self._where = where
        self._slow = slow

    def __await__(self) -> Generator[Any, Any, Any]:
        coroutine = self._coroutine
        sent: Any = None
        thrown: BaseException | None = None
        while True:
            begun = time.monotonic_ns()
            try:
                waited = coroutine.send(sent) if thrown is None else coroutine.throw(thrown)
            except StopIteration as stop:
                return stop.value
            finally:
                self._slow.check(self._where, time.monotonic_ns() - begun)
            sent, thrown = None, None
            try:
                sent = yield waited
            except GeneratorExit:
                coroutine.close()
                raise
            except BaseException as error:  # noqa: BLE001 - cancellation goes to the coroutine too
                thrown = error


ExceptionHandler = Callable[[Exception, str], None]
"""Called with each exception that a callback raises, and the name of that callback."""


class Runtime:
    """The state that one executor shares with its `Source`s. For the loop's thread only."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sync: Callable[[], None],
        on_exception: ExceptionHandler | None,
    ) -> None:
        self.loop = loop
        self.sync = sync
        self.stale = False
        """Whether `sync` must be called before the next callback."""
        self.tasks: set[asyncio.Task[None]] = set()
        self.slow = SlowCallbacks()
        self.slice_ns = SLICE_NS
        self.flooded: set[object] = set()
        """The sources with data left at the end of their last time slice."""
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
        """Return the `Pool` with rests of `rest_s` seconds. Create it if needed."""
        if rest_s not in self._pools:
            self._pools[rest_s] = Pool(self.loop, rest_s)
        return self._pools[rest_s]

    def close_pools(self) -> None:
        """Close all pools. Every `Source` must be detached before."""
        for pool in self._pools.values():
            pool.close()
        self._pools.clear()

    def mark_flooded(self, source: object) -> None:
        """Record that `source` had data left at the end of its time slice."""
        if source not in self.flooded:
            self.flooded.add(source)
            self._share_turn()

    def mark_drained(self, source: object) -> None:
        """Record that `source` has no data left."""
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
        """Run an async callback as a task, and call `finished` when the task ends in any way."""

        async def run() -> None:
            try:
                await TimedSteps(coroutine, where, self.slow)
            except Exception as error:  # noqa: BLE001 - handed to the one handler
                self.report(error, where)

        def end(task: asyncio.Task[None]) -> None:
            self.tasks.discard(task)
            # Otherwise a task cancelled before its first step warns of a never awaited coroutine.
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
        """Call `callback` when no task runs, at once if none runs now."""
        self._on_idle = callback
        if not self.tasks:
            callback()

    def park(self, group: CallbackGroup, source: Resumable) -> None:
        """Resume `source` when `group` is released."""
        self._parked.setdefault(group, {})[source] = None

    def release(self, group: CallbackGroup) -> None:
        """Resume the sources that wait for `group`."""
        for source in self._parked.pop(group, ()):
            source.resume()


def name_of(callback: Any) -> str:
    """Return the name of a callback for the log."""
    name = getattr(callback, "__qualname__", None)
    return name if isinstance(name, str) else repr(callback)
