"""A ticker on absolute times, driven by a Linux timer."""

from __future__ import annotations

import asyncio
import ctypes
import math
import os
import time
import weakref
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple, Self

from robotctl.ros.executor.event_loop import NS_PER_S, beat_before, unwatch, watch

_TFD_TIMER_ABSTIME = 1


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _TimeSpec), ("value", _TimeSpec))


@cache
def _libc() -> Any:
    # `os.timerfd_create` came only with Python 3.13.
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
    """A timer on the steady clock. Its descriptor `fd` is readable after an expiry."""

    __slots__ = ("fd",)

    def __init__(self) -> None:
        """Create a disarmed timer.

        Raises:
            OSError: No file descriptor is left.
        """
        flags = os.O_NONBLOCK | os.O_CLOEXEC
        self.fd: int = _libc().timerfd_create(time.CLOCK_MONOTONIC, flags)
        if self.fd < 0:
            raise _fail("timerfd_create")

    def arm_after(self, delay_ns: int) -> None:
        """Expire once, `delay_ns` from now, or at once if `delay_ns` is not positive."""
        self._set(0, max(delay_ns, 1), 0)

    def arm_periodic(self, first_ns: int, period_ns: int) -> None:
        """Expire at `first_ns` (`time.monotonic_ns`), then every `period_ns`, without drift."""
        self._set(_TFD_TIMER_ABSTIME, max(first_ns, 1), period_ns)

    def disarm(self) -> None:
        """Stop the timer until it is armed again."""
        self._set(0, 0, 0)

    def read(self) -> int:
        """Return the number of expiries since the last read, without waiting."""
        try:
            return int.from_bytes(os.read(self.fd, 8), "little")
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the file descriptor. A second call does nothing."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def _set(self, flags: int, value_ns: int, interval_ns: int) -> None:
        spec = _TimerSpec(
            _TimeSpec(*divmod(interval_ns, NS_PER_S)), _TimeSpec(*divmod(value_ns, NS_PER_S))
        )
        if _libc().timerfd_settime(self.fd, flags, ctypes.byref(spec), None) != 0:
            raise _fail("timerfd_settime")


MAX_HZ = 10_000.0


class Tick(NamedTuple):
    """One tick of a `Ticker`, with times of `time.monotonic_ns`."""

    t_ns: int
    """When the tick was delivered."""
    due_ns: int
    """When the tick was due."""
    missed: int
    """The number of ticks skipped since the last delivered one."""


class Ticker:
    """Ticks at a fixed rate on the steady clock, without drift, for one task at a time.

        async for tick in Ticker(50.0):
            step(tick.t_ns)

    All tickers of one rate and lead in a process tick together. Ticks that fall due while the task
    is busy are skipped. `close`, `async with` or garbage collection releases the timer.
    """

    def __init__(self, hz: float, *, lead_ns: int = 0) -> None:
        """Tick `hz` times a second, `lead_ns` before tickers of this rate without a lead.

        Raises:
            ValueError: `hz` is not a finite number in (0, 10000].
        """
        if not (math.isfinite(hz) and 0.0 < hz <= MAX_HZ):
            raise ValueError(f"a ticker's rate must be above 0 and at most {MAX_HZ:g} Hz, not {hz}")
        self.period_ns = round(NS_PER_S / hz)
        self._lead_ns = lead_ns
        self._on_tick: Callable[[Tick], None] | None = None
        self._timer: TimerFd | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiter: asyncio.Future[None] | None = None
        self._due_ns = 0
        self._expired = 0
        self._closed = False

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Tick:
        """Wait for the next tick.

        Raises:
            StopAsyncIteration: The ticker was closed.
            RuntimeError: Another task waits already, or the ticker runs in another loop.
        """
        self._start()
        while self._expired == 0:
            if self._closed:
                raise StopAsyncIteration
            await self._wait()
        return self._take()

    async def run(self, on_tick: Callable[[Tick], None]) -> None:
        """Call `on_tick` for each tick until the ticker is closed.

        Raises:
            Exception: `on_tick` raised it.
            RuntimeError: Another task waits already, or the ticker runs in another loop.
        """
        self._start()
        self._on_tick = on_tick
        try:
            if not self._closed:
                await self._wait()
        finally:
            self._on_tick = None

    async def __aenter__(self) -> Self:
        self._start()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop ticking, and end a waiting `async for` or `run`. A second call does nothing."""
        self._closed = True
        timer, self._timer = self._timer, None
        if timer is not None:
            assert self._loop is not None
            unwatch(self._loop, timer.fd)
            timer.close()
        self._expired = 0
        self._release()

    def __del__(self) -> None:
        if getattr(self, "_timer", None) is not None:
            self.close()

    def _start(self) -> None:
        if self._waiter is not None:
            raise RuntimeError("another task waits for this ticker; give each task its own")
        loop = asyncio.get_running_loop()
        if self._closed:
            return
        if self._timer is None:
            self._loop = loop
            self._timer = TimerFd()
            now_ns = time.monotonic_ns()
            self._due_ns = beat_before(now_ns + self._lead_ns, self.period_ns) - self._lead_ns
            self._timer.arm_periodic(self._due_ns + self.period_ns, self.period_ns)
            # A weak reference: the loop must not keep an unused ticker alive.
            watch(loop, self._timer.fd, partial(_wake, weakref.ref(self)))
        elif loop is not self._loop:
            raise RuntimeError("this ticker runs in another event loop; give each loop its own")

    def _on_expiry(self) -> None:
        # Read even when no task waits: a readable descriptor would keep waking the loop.
        # Read only here, in a turn of the loop: a task that is always late cannot starve it.
        if self._timer is not None:
            self._expired += self._timer.read()
        if self._on_tick is None:
            self._release()
        elif self._expired and self._waiter is not None and not self._waiter.done():
            try:
                self._on_tick(self._take())
            except Exception as error:  # noqa: BLE001 - it goes to the task that waits
                self._waiter.set_exception(error)

    def _take(self) -> Tick:
        expired, self._expired = self._expired, 0
        self._due_ns += expired * self.period_ns
        return Tick(t_ns=time.monotonic_ns(), due_ns=self._due_ns, missed=expired - 1)

    async def _wait(self) -> None:
        assert self._loop is not None
        self._waiter = self._loop.create_future()
        try:
            await self._waiter
        finally:
            self._waiter = None

    def _release(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)


def _wake(reference: weakref.ref[Ticker]) -> None:
    ticker = reference()
    if ticker is not None:
        ticker._on_expiry()
