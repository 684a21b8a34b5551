"""Sources, which pass the data of one ROS entity from rcl to its callback."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from types import CoroutineType
from typing import Any, ClassVar

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import JumpHandle, JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.timer import Timer

from robotctl.ros.executor import announcements
from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.event_loop import SLOW_CALLBACK_NS, unwatch, watch
from robotctl.ros.executor.rcutils import RclCallFailed, UnsupportedPlatform
from robotctl.ros.executor.runtime import Pool, Runtime, log
from robotctl.ros.executor.ticker import TimerFd

RETRY_AFTER_FAILED_TAKE_S = 0.1


class Source(ABC):
    """Runs the callback of one ROS entity in the event loop, from `attach` to `detach`."""

    woken_by: ClassVar[str]
    """The cause of a wake-up, as text for the debug log."""

    def __init__(self, runtime: Runtime, entity: Any, handle: Any, where: str) -> None:
        self.runtime = runtime
        self.entity = entity
        self.handle = handle
        self.where = where
        self.closed = False
        self.group: Any = entity.callback_group
        self._reentrant = type(self.group) is ReentrantCallbackGroup
        # A group of another class than rclpy's is asked before each callback. rclpy's are not:
        # synchronous callbacks of one loop exclude each other anyway.
        self._custom_group = type(self.group) not in (
            ReentrantCallbackGroup,
            MutuallyExclusiveCallbackGroup,
        )

    @abstractmethod
    def attach(self) -> None:
        """Begin to deliver the entity's data.

        Raises:
            InvalidHandle: The entity has been destroyed already.
            OSError: No file descriptor is left.
        """

    @abstractmethod
    def detach(self) -> None:
        """Stop delivering, and release the entity. A second call does nothing."""

    @abstractmethod
    def resume(self) -> None:
        """Continue to deliver. The runtime calls this when the callback group is free again."""

    def blocked(self) -> bool:
        """Return whether the callback group is busy. If it is, `resume` follows later."""
        if self._reentrant:
            return False
        if self._custom_group:
            if self.group.can_execute(self.entity):
                return False
        elif self.group._active_entity is None:
            # The same test as can_execute's, without its lock and weak reference, for speed.
            return False
        self.runtime.park(self.group, self)
        return True

    def run_callback(self, callback: Callable[[], Any]) -> bool:
        """Run `callback` and return True, or return False if a custom callback group refuses.

        After False, `resume` follows later. An exception goes to the exception handler.
        """
        if self._custom_group and not self.group.beginning_execution(self.entity):
            self.runtime.park(self.group, self)
            return False
        begun = time.monotonic_ns()
        rest = None
        try:
            rest = callback()
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self.runtime.report(error, self.where)
        finally:
            if self._custom_group:
                self._leave_group()
        self.runtime.slow.check(self.where, time.monotonic_ns() - begun)
        if isinstance(rest, CoroutineType):
            self.run_async(rest)
        return True

    def run_async(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        """Run the coroutine of an async callback as a task that occupies the callback group."""
        self.group.beginning_execution(self.entity)
        self.runtime.spawn(coroutine, self.where, self._leave_group)

    def _leave_group(self) -> None:
        self.group.ending_execution(self.entity)
        self.runtime.release(self.group)


class EventFdSource(Source):
    """A `Source` that rcl wakes by an eventfd."""

    woken_by = "eventfd"
    announcements: ClassVar[tuple[Announcement, ...]]
    drains_first: ClassVar[bool] = True
    """Whether `attach` also delivers data that arrived earlier."""
    announced = 0
    """The last count that was read from the eventfd."""

    pool: Pool | None = None
    """The `Pool` that watches the eventfd, or None if the loop itself watches it."""

    _listening = False

    def attach(self) -> None:
        # Held until `detach`, so that rclpy does not destroy the entity earlier.
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
        self.runtime.mark_drained(self)
        for each in self.announcements:
            try:
                announcements.unwatch(each, self.handle.pointer)
            except (RclCallFailed, UnsupportedPlatform) as error:
                log.debug("%s: %s", self.where, error)
        self.stop_listening()
        os.close(self._fd)
        self.handle.__exit__(None, None, None)

    def listen(self, pool: Pool | None) -> None:
        """Watch the eventfd by `pool`, or by the loop if `pool` is None."""
        self.stop_listening()
        if pool is None:
            watch(self.runtime.loop, self._fd, self.poll)
        else:
            pool.add(self._fd, self)
        self.pool, self._listening = pool, True

    def stop_listening(self) -> None:
        """Stop watching the eventfd. Then only a call of `poll` delivers data."""
        if not self._listening:
            return
        self._listening = False
        if self.pool is not None:
            self.pool.remove(self._fd)
        else:
            unwatch(self.runtime.loop, self._fd)

    def resume(self) -> None:
        if not self.closed:
            os.eventfd_write(self._fd, 1)

    def poll(self) -> bool:
        """Deliver the waiting data. Return True if the time slice ended with data left."""
        try:
            self.announced = os.eventfd_read(self._fd)
        except BlockingIOError:
            return False  # it was polled earlier in this turn
        if self.runtime.stale:
            self.runtime.sync()
            if self.closed:
                return False
        is_free = self._reentrant or (not self._custom_group and self.group._active_entity is None)
        if not is_free and self.blocked():
            return False
        return self.drain()

    def drain(self) -> bool:
        """Deliver until no data are left or the time slice ends. Return True if the slice ended."""
        runtime = self.runtime
        last = time.monotonic_ns()
        end = last + runtime.slice_ns
        while True:
            if self._custom_group and not self.group.beginning_execution(self.entity):
                runtime.park(self.group, self)
                return False
            rest = None
            try:
                item = self.take()
                if item is None:
                    runtime.mark_drained(self)
                    return False
                rest = self.deliver(item)
            except TakeFailed as failure:
                self.retry_later(failure.reason)
                return False
            except Exception as error:  # noqa: BLE001 - goes to the exception handler
                runtime.report(error, self.where)
            finally:
                if self._custom_group:
                    self._leave_group()
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
                return self.continue_later()

    def retry_later(self, reason: Exception) -> None:
        """Report a failed take, and try again after RETRY_AFTER_FAILED_TAKE_S."""
        self.runtime.report(reason, self.where)
        self.runtime.loop.call_later(RETRY_AFTER_FAILED_TAKE_S, self.resume)

    def continue_later(self) -> bool:
        """Schedule delivery of the remaining data in a later turn of the loop, and return True."""
        self.runtime.mark_flooded(self)
        os.eventfd_write(self._fd, 1)
        return True

    def take(self) -> Any:
        """Return the next item, or None if there is none.

        Raises:
            TakeFailed: rcl could not take the item.
        """
        raise NotImplementedError

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        """Run the callback with `item`. Return its coroutine, or None if it is not async."""
        raise NotImplementedError


class TakeFailed(Exception):
    """rcl could not take an item. `reason` is the original exception."""

    def __init__(self, reason: Exception) -> None:
        super().__init__(str(reason))
        self.reason = reason


# Every step of the clock: rcl's on-reset callback is not called when /clock moves.
_ANY_JUMP = JumpThreshold(
    min_forward=Duration(nanoseconds=1),
    min_backward=Duration(nanoseconds=-1),
    on_clock_change=True,
)


class TimerSource(Source):
    """Calls the callback of a timer on the steady, system or ROS clock."""

    woken_by = "timerfd"

    def __init__(self, runtime: Runtime, timer: Timer, where: str) -> None:
        super().__init__(runtime, timer, timer.handle, where)
        self._jumps: JumpHandle | None = None

    def attach(self) -> None:
        self.handle.__enter__()
        self._timer_fd: TimerFd | None = None
        self._reset_fd = -1
        try:
            self._timer_fd = TimerFd()
            self._reset_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            announcements.watch(Announcement.TIMER_RESET, self.handle.pointer, self._reset_fd)
            watch(self.runtime.loop, self._reset_fd, self._on_reset)
            watch(self.runtime.loop, self._timer_fd.fd, self._on_expiry)
            if isinstance(self.entity.clock, ROSClock):
                self._jumps = self.entity.clock.create_jump_callback(
                    _ANY_JUMP, post_callback=self._on_jump
                )
        except BaseException:
            self.detach()
            raise
        self.resume()

    def detach(self) -> None:
        if self.closed:
            return
        self.closed = True
        if self._jumps is not None:
            self._jumps.unregister()
        if self._reset_fd >= 0:
            announcements.unwatch(Announcement.TIMER_RESET, self.handle.pointer)
            unwatch(self.runtime.loop, self._reset_fd)
            os.close(self._reset_fd)
        if self._timer_fd is not None:
            unwatch(self.runtime.loop, self._timer_fd.fd)
            self._timer_fd.close()
        self.handle.__exit__(None, None, None)

    def resume(self) -> None:
        if self.closed:
            return
        assert self._timer_fd is not None
        if self.handle.is_timer_canceled():
            self._timer_fd.disarm()
            return
        remaining_ns = self.handle.time_until_next_call()
        clock = self.entity.clock
        # While /clock drives the ROS clock, no Linux timer can know when this timer is due:
        # `_on_jump` checks it at each message of /clock.
        if remaining_ns is None or (
            remaining_ns > 0 and isinstance(clock, ROSClock) and clock.ros_time_is_active
        ):
            self._timer_fd.disarm()
        else:
            self._timer_fd.arm_after(remaining_ns)

    def _on_reset(self) -> None:
        os.eventfd_read(self._reset_fd)
        self.resume()

    def _on_jump(self, _: object) -> None:
        # Runs in the thread that sets the clock, while it does so: check later, in the loop.
        self.runtime.loop.call_soon_threadsafe(self.resume)

    def _on_expiry(self) -> None:
        assert self._timer_fd is not None
        self._timer_fd.read()
        if self.runtime.stale:
            self.runtime.sync()
            if self.closed:
                return
        if self.blocked():
            return
        # Ask rcl: the timer may be cancelled or reset, or not due because its clock runs slower.
        if self.handle.is_timer_canceled() or not self.handle.is_timer_ready():
            self.resume()
            return
        if self.run_callback(self._fire):
            self.resume()

    def _fire(self) -> Any:
        self.handle.call_timer()
        return self.entity.callback()
