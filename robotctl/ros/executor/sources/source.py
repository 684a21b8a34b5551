"""What brings an entity's data from rcl into the loop, and into its callback: the common part."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Coroutine
from types import CoroutineType
from typing import Any, ClassVar

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup

from robotctl.ros.executor import announcements
from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.errors import RclCallFailed, UnsupportedPlatform
from robotctl.ros.executor.pool import Pool
from robotctl.ros.executor.runtime import Runtime, log
from robotctl.ros.executor.time_limits import SLOW_CALLBACK_NS

RETRY_AFTER_FAILED_TAKE_S = 0.1


class Source:
    """An entity on its way into the loop: attached once, detached once, parked in between.

    A callback group that is busy with an async callback parks the source; the end of that
    callback resumes it.
    """

    path: ClassVar[str]
    """How it comes here, for the debug log."""

    def __init__(self, runtime: Runtime, entity: Any, handle: Any, where: str) -> None:
        self.runtime = runtime
        self.entity = entity
        self.handle = handle
        self.where = where
        self.closed = False
        self.group: Any = entity.callback_group
        self._free = type(self.group) is ReentrantCallbackGroup
        # Synchronous callbacks of one loop exclude each other anyway; a group of the user's own
        # making is asked for each of them.
        self._strict = type(self.group) not in (
            ReentrantCallbackGroup,
            MutuallyExclusiveCallbackGroup,
        )

    def attach(self) -> None:
        """Begin to deliver.

        Raises:
            InvalidHandle: the entity was destroyed meanwhile.
            OSError: no file descriptor is left.
        """
        raise NotImplementedError

    def detach(self) -> None:
        """Deliver nothing more and let go of the entity; a second time does nothing."""
        raise NotImplementedError

    def resume(self) -> None:
        """The callback group became free: look for work again."""
        raise NotImplementedError

    def blocked(self) -> bool:
        """Whether the callback group forbids a callback now; then the source is parked."""
        if self._free:
            return False
        if self._strict:
            if self.group.can_execute(self.entity):
                return False
        elif self.group._active_entity is None:
            # What can_execute would find out with a lock and a weak reference, at every message.
            return False
        self.runtime.park(self.group, self)
        return True

    def call_back(self, callback: Callable[[], Any]) -> bool:
        """Run one callback; False where the group forbids it after all, and parks the source."""
        if self._strict and not self.group.beginning_execution(self.entity):
            self.runtime.park(self.group, self)
            return False
        begun = time.monotonic_ns()
        rest = None
        try:
            rest = callback()
        except Exception as error:  # noqa: BLE001 - handed to the one handler
            self.runtime.report(error, self.where)
        finally:
            if self._strict:
                self._end_async()
        self.runtime.slow.check(self.where, time.monotonic_ns() - begun)
        if isinstance(rest, CoroutineType):
            self.run_async(rest)
        return True

    def run_async(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        """Run the callback's coroutine as a task that occupies the callback group."""
        self.group.beginning_execution(self.entity)
        self.runtime.spawn(coroutine, self.where, self._end_async)

    def _end_async(self) -> None:
        self.group.ending_execution(self.entity)
        self.runtime.release(self.group)


class EventFdSource(Source):
    """An entity for which rcl writes to an eventfd that asyncio watches."""

    path = "eventfd"
    announcements: ClassVar[tuple[Announcement, ...]]
    drains_first: ClassVar[bool] = True
    """Whether there may be data from before the attachment that nobody announces."""
    announced = 0
    """How many times rcl had signalled when the eventfd was last read."""

    pool: Pool | None = None
    """Who looks after the eventfd; without a pool the loop does."""

    _listening = False

    def attach(self) -> None:
        # Held from now on: rclpy destroys the entity only after `detach`.
        self.handle.__enter__()
        try:
            self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        except OSError:
            self.handle.__exit__(None, None, None)
            raise
        try:
            for each in self.announcements:
                announcements.watch(each, self.handle.pointer, self._fd)
            self.listen(self.pool)
        except BaseException:
            self.detach()
            raise
        if self.drains_first:
            self.resume()

    def detach(self) -> None:
        if self.closed:
            return
        self.closed = True
        self.runtime.drained(self)
        for each in self.announcements:
            try:
                announcements.unwatch(each, self.handle.pointer)
            except (RclCallFailed, UnsupportedPlatform) as error:
                log.debug("%s: %s", self.where, error)
        self._stop_listening()
        os.close(self._fd)
        self.handle.__exit__(None, None, None)

    def listen(self, pool: Pool | None) -> None:
        """Let the pool look after the eventfd; without one the loop does, at every message."""
        self._stop_listening()
        if pool is None:
            self.runtime.loop.add_reader(self._fd, self.look)
        else:
            pool.add(self._fd, self)
        self.pool, self._listening = pool, True

    def _stop_listening(self) -> None:
        if not self._listening:
            return
        self._listening = False
        if self.pool is not None:
            self.pool.remove(self._fd)
        elif not self.runtime.loop.is_closed():
            self.runtime.loop.remove_reader(self._fd)

    def resume(self) -> None:
        if not self.closed:
            os.eventfd_write(self._fd, 1)

    def look(self) -> bool:
        """Deliver what is there; whether something is left because the slice is over."""
        self.announced = os.eventfd_read(self._fd)
        if self.runtime.stale:
            self.runtime.sync()
            if self.closed:
                return False
        if self.blocked():
            return False
        return self.drain()

    def drain(self) -> bool:
        """Deliver until nothing is left or the slice is over; then the others have a turn."""
        runtime = self.runtime
        last = time.monotonic_ns()
        end = last + runtime.slice_ns
        while True:
            if self._strict and not self.group.beginning_execution(self.entity):
                runtime.park(self.group, self)
                return False
            rest = None
            try:
                item = self.take()
                if item is None:
                    runtime.drained(self)
                    return False
                rest = self.deliver(item)
            except TakeFailed as failure:
                self.retry_later(failure.reason)
                return False
            except Exception as error:  # noqa: BLE001 - handed to the one handler
                runtime.report(error, self.where)
            finally:
                if self._strict:
                    self._end_async()
            now = time.monotonic_ns()
            if now - last > SLOW_CALLBACK_NS:
                runtime.slow.check(self.where, now - last)
            last = now
            if rest is not None:
                self.run_async(rest)
            if runtime.stale:
                runtime.sync()
            if self.closed or (rest is not None and self.blocked()):
                return False
            if now > end:
                return self.to_be_continued()

    def retry_later(self, reason: Exception) -> None:
        """rcl could not hand over a datum: report, and do not ask again at once."""
        self.runtime.report(reason, self.where)
        self.runtime.loop.call_later(RETRY_AFTER_FAILED_TAKE_S, self.resume)

    def to_be_continued(self) -> bool:
        """The slice is over: look again in the next turn of the loop."""
        self.runtime.flooded(self)
        os.eventfd_write(self._fd, 1)
        return True

    def take(self) -> Any:
        """The next datum, or None.

        Raises:
            TakeFailed: rcl could not hand it over.
        """
        raise NotImplementedError

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        """Run the callback; what it returns is the rest of an async one."""
        raise NotImplementedError


class TakeFailed(Exception):
    """rcl could not hand over a datum; asking again at once would fail again."""

    def __init__(self, reason: Exception) -> None:
        super().__init__(str(reason))
        self.reason = reason


def rest_of(result: Any) -> Coroutine[Any, Any, Any] | None:
    """What a callback has left to do, if it is async."""
    return result if isinstance(result, CoroutineType) else None
