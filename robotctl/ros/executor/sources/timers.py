"""rclpy's timers: a timerfd wakes the loop, rcl decides whether the timer is due."""

from __future__ import annotations

import os
from typing import Any

from rclpy.clock import JumpHandle, JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.timer import Timer

from robotctl.ros.executor import announcements
from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.event_loop import unwatch, watch
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.sources.source import Source
from robotctl.ros.executor.ticker import TimerFd

# Every step of the clock: rcl's on-reset callback is not called when /clock moves.
_ANY_JUMP = JumpThreshold(
    min_forward=Duration(nanoseconds=1),
    min_backward=Duration(nanoseconds=-1),
    on_clock_change=True,
)


class TimerSource(Source):
    """A timer on the steady, system or ROS clock, with cancel and reset.

    While /clock drives the ROS clock, no Linux timer can know when this timer is due. So this
    timer is then checked at each step of the clock.
    """

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
