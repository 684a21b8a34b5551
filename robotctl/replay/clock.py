"""The steady clock, with more exact waiting than `time.sleep`."""

from __future__ import annotations

import ctypes
import errno
import os
import time
from typing import Final, Protocol

from robotctl.kernel.units import NS_PER_S

SPIN_NS: Final = 40_000
"""How long the end of a wait polls the clock, because the scheduler may wake us up this late."""

_PR_SET_TIMERSLACK: Final = 29
_NO_SLACK_NS: Final = 1
"""Otherwise Linux wakes a thread up to 50 us late, to wake it together with others."""

_TIMER_ABSTIME: Final = 1


class Clock(Protocol):
    """A monotonic clock in nanoseconds."""

    def now_ns(self) -> int:
        """Return the time."""

    def sleep_until(self, moment_ns: int) -> None:
        """Return at `moment_ns`, or at once if it has passed."""


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class SteadyClock:
    """CLOCK_MONOTONIC, for use by one thread."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=False)  # releases the GIL while it sleeps
        self._sleep = libc.clock_nanosleep
        self._sleep.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        self._prctl = libc.prctl
        self._has_slack = True
        self._until = _Timespec()
        self._pointer = ctypes.addressof(self._until)

    def now_ns(self) -> int:
        """Return the time."""
        return time.monotonic_ns()

    def sleep_until(self, moment_ns: int) -> None:
        """Return at `moment_ns`, within a few microseconds.

        Raises:
            OSError: The system call fails.
        """
        if self._has_slack:
            self._has_slack = False
            self._prctl(_PR_SET_TIMERSLACK, _NO_SLACK_NS, 0, 0, 0)  # of the calling thread
        until = self._until
        until.seconds, until.nanoseconds = divmod(max(moment_ns - SPIN_NS, 0), NS_PER_S)
        failure = errno.EINTR
        while failure == errno.EINTR:
            failure = self._sleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, self._pointer, None)
        if failure:
            raise OSError(failure, os.strerror(failure))
        while time.monotonic_ns() < moment_ns:
            pass
