"""A Linux timer as a file descriptor; asyncio's own timers round to 1 ms.

It uses ctypes, because `os.timerfd_create` came with Python 3.13.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from typing import Any

from robotctl.ros.executor.time_limits import NS_PER_S

_CLOCK_MONOTONIC = 1
_TFD_TIMER_ABSTIME = 1
_TFD_NONBLOCK = os.O_NONBLOCK
_TFD_CLOEXEC = os.O_CLOEXEC


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _TimeSpec), ("value", _TimeSpec))


@cache
def _libc() -> Any:
    library = ctypes.CDLL(None, use_errno=True)
    library.timerfd_settime.argtypes = [
        ctypes.c_int,
        ctypes.c_int,
        ctypes.POINTER(_TimerSpec),
        ctypes.c_void_p,
    ]
    return library


def _fail(what: str) -> OSError:
    number = ctypes.get_errno()
    return OSError(number, f"{what}: {os.strerror(number)}")


class TimerFd:
    """A timer on the steady clock whose `fd` becomes readable when it expires."""

    __slots__ = ("_closed", "fd")

    def __init__(self) -> None:
        """Create a disarmed timer.

        Raises:
            OSError: No file descriptor is left.
        """
        self._closed = False
        self.fd: int = _libc().timerfd_create(_CLOCK_MONOTONIC, _TFD_NONBLOCK | _TFD_CLOEXEC)
        if self.fd < 0:
            self._closed = True
            raise _fail("timerfd_create")

    def arm_after(self, delay_ns: int) -> None:
        """Expire once, `delay_ns` from now; at once if the delay is not positive."""
        self._set(0, max(delay_ns, 1), 0)

    def arm_periodic(self, first_ns: int, period_ns: int) -> None:
        """Expire at `first_ns` (`time.monotonic_ns`), then every `period_ns`, without drift."""
        self._set(_TFD_TIMER_ABSTIME, max(first_ns, 1), period_ns)

    def disarm(self) -> None:
        """Stop the timer until it is armed again."""
        self._set(0, 0, 0)

    def read(self) -> int:
        """Return how many times it expired since the last read."""
        try:
            return int.from_bytes(os.read(self.fd, 8), "little")
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the file descriptor; a second call does nothing."""
        if not self._closed:
            self._closed = True
            os.close(self.fd)

    def _set(self, flags: int, value_ns: int, interval_ns: int) -> None:
        spec = _TimerSpec(
            _TimeSpec(*divmod(interval_ns, NS_PER_S)), _TimeSpec(*divmod(value_ns, NS_PER_S))
        )
        if _libc().timerfd_settime(self.fd, flags, ctypes.byref(spec), None) != 0:
            raise _fail("timerfd_settime")
