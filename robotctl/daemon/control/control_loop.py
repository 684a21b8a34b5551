"""The control loop, and the watchdog that sends zeros while the loop is stalled."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Final, Protocol, Self

from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.inputs import ForeignCommands
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Cause, FaultReported, LoopStalled, Tick
from robotctl.ros.executor import Tick as LoopTick
from robotctl.ros.executor import Ticker
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher

_log = logging.getLogger(__name__)

LINE_BYTES: Final = 128
"""Number of bytes read from `schedstat`, more than its one line has."""


class ProcessorWait:
    """Reads the CPU waiting time of the thread that creates this object."""

    def __init__(self) -> None:
        self._account: int | None = None
        try:
            path = f"/proc/self/task/{threading.get_native_id()}/schedstat"
            # Kept open: the process may run out of descriptors later.
            self._account = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:  # this system has no accounting
            return

    def close(self) -> None:
        """Close the file in /proc from which the waiting time is read."""
        if self._account is not None:
            os.close(self._account)
            self._account = None

    def waited_ns(self) -> int:
        """Return the total time [ns] that the thread has waited for a CPU, 0 if unknown."""
        if self._account is None:
            return 0
        return int(os.pread(self._account, LINE_BYTES, 0).split()[1])


def pressure() -> str:
    """Return the CPU pressure (PSI, last 10 s) as text after a comma, "" if unknown."""
    try:
        with open("/proc/pressure/cpu", encoding="ascii") as file:
            fields = file.readline().split()
        return f", CPU pressure {float(fields[1].removeprefix('avg10=')):.0f} %"
    except (OSError, ValueError, IndexError):
        return ""


STALL_S = 0.1
"""A stall lasts at least this time without a tick."""

CONFIRM_S = 0.02
"""How long the watchdog waits for a late tick of a paused process before it sends zeros."""

STALL_TICKS = 2.5
"""A stall lasts at least this number of tick periods without a tick."""

ZERO_PERIOD_S = 0.05
"""Period of the zeros while the loop is stalled."""

SHOWN_FRAMES = 3
"""How many calls the report of a stall names, from the innermost outwards."""

BUSY_SHARE = 0.5
"""Share of the time in wait for a CPU above which the machine counts as busy."""

ACCOUNT_PERIOD_NS = 100_000_000
"""Period of reading the CPU wait, which at each tick took 3 % of the loop's time."""


class Gate(Protocol):
    """A command publisher that the watchdog can close for all commands except its zeros."""

    def close_gate(self) -> None:
        """Pass only zeros from now on; called in the watchdog's thread."""

    def publish_zero(self) -> None:
        """Publish a zero while the gate is closed; called in the watchdog's thread."""

    def open_gate(self) -> tuple[int, int]:
        """Pass all commands again; return the numbers of zeros sent and of commands withheld."""


class Watchdog:
    """Commands zero velocity from a thread of its own while the control loop does not tick.

    The zeros end when the loop calls `take`. A C call that holds the GIL blocks this thread, too.
    """

    def __init__(
        self,
        rate_hz: float,
        gate: Gate,
        now_ns: Callable[[], int] = time.monotonic_ns,
        ended: threading.Event | None = None,
    ) -> None:
        """The end of the block sets `ended`."""
        self._limit_ns = round(max(STALL_S, STALL_TICKS / rate_hz) * NS_PER_S)
        self._gate = gate
        self._now_ns = now_ns
        self._last_ns = 0
        """The time of the last tick."""
        self._stalled_ns = 0
        """The time of the last tick before the stall."""
        self._account_ns = 0
        self._waited_ns = 0
        """The thread's CPU waiting time [ns] at the time `_account_ns`."""
        self._holding = False
        self._where = ""
        self._unsent = 0
        self._failure = ""
        self._ended = threading.Event() if ended is None else ended
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)

    def __enter__(self) -> Self:
        self._watched = threading.get_ident()
        self._processor = ProcessorWait()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._processor.close()

    def ping(self) -> None:
        """Note that the loop has just handled a tick."""
        now_ns = self._last_ns = self._now_ns()
        if not self._holding and now_ns - self._account_ns >= ACCOUNT_PERIOD_NS:
            self._account_ns, self._waited_ns = now_ns, self._processor.waited_ns()
        if self._thread.ident is None:
            self._thread.start()

    def take(self) -> LoopStalled | FaultReported | None:
        """Return LoopStalled after a stall, FaultReported if the thread failed, otherwise None.

        A stall's end opens `gate`. Call this in the loop's thread, and dispatch the event next.
        """
        if self._holding:
            return self._end_stall()
        if self._failure:
            detail, self._failure = self._failure, ""
            return FaultReported(self._now_ns(), Cause.TASK_DIED, detail)
        return None

    # In the loop's thread

    def _end_stall(self) -> LoopStalled:
        now_ns = self._now_ns()
        zeros, withheld = self._gate.open_gate()
        self._holding = False  # without a tick the stall continues: only `ping` ends it
        stalled_s = (now_ns - self._stalled_ns) / NS_PER_S
        waited_s = (self._processor.waited_ns() - self._waited_ns) / NS_PER_S
        if waited_s > BUSY_SHARE * (now_ns - self._account_ns) / NS_PER_S:
            without_s = min(waited_s, stalled_s)
            detail = f"the machine was busy: no processor for {without_s:.2f} s{pressure()}"
        else:
            detail = f"in {self._where}" if self._where else "the loop was held up"
        if self._unsent:
            detail = f"{detail}; {self._unsent} zeros could not be sent"
            self._unsent = 0
        _log.warning("the loop stalled for %.2f s: %s", stalled_s, detail)
        return LoopStalled(now_ns, stalled_s, zeros, withheld, detail)

    # In the watchdog's thread. Before the first zero, it opens no file, imports and logs nothing,
    # and acquires no lock but the publisher's.

    def _run(self) -> None:
        try:
            self._watch()
        except BaseException as error:  # noqa: BLE001 - the loop must get any failure
            self._failure = "the watchdog failed"
            self._failure = f"the watchdog failed ({type(error).__name__}: {error})"

    def _watch(self) -> None:
        while not self._ended.wait(self._due_s()):
            if not self._is_due():  # the loop has ticked in time
                continue
            self._ended.wait(CONFIRM_S)
            if self._is_due():
                self._hold()

    def _is_due(self) -> bool:
        return self._due_s() <= 0.0 and not self._ended.is_set()

    def _due_s(self) -> float:
        """Return the time [s] until the loop counts as stalled, negative if it does already."""
        return (self._last_ns + self._limit_ns - self._now_ns()) / NS_PER_S

    def _hold(self) -> None:
        """Send zeros until the loop calls `take`."""
        self._where = ""
        self._stalled_ns = self._last_ns
        self._gate.close_gate()
        self._holding = True
        self._send_zero()
        self._where = where(sys._current_frames().get(self._watched))
        while self._holding and not self._ended.wait(ZERO_PERIOD_S):
            self._send_zero()

    def _send_zero(self) -> None:
        try:
            self._gate.publish_zero()
        except Exception:  # noqa: BLE001 - the next zero may succeed
            self._unsent += 1


def where(frame: FrameType | None) -> str:
    """Return the innermost calls of a stack as text."""
    calls: list[str] = []
    while frame is not None and len(calls) < SHOWN_FRAMES:
        code = frame.f_code
        file = code.co_filename.rpartition("/")[2]
        calls.append(f"{code.co_qualname} ({file}:{frame.f_lineno})")
        frame = frame.f_back
    return ", called by ".join(calls)


LOOKS_ENOUGH_HZ: Final = 50.0
"""Control rate from which commands of other publishers are handled once in each tick."""

COMMAND_LATENCY_S: Final = 0.01
"""Limit on the delay of other publishers' commands below LOOKS_ENOUGH_HZ."""


class ControlLoop:
    """Dispatches ticks to the kernel at the control rate, and pings the watchdog."""

    def __init__(
        self, rate_hz: float, control: Control, watchdog: Watchdog, velocity: VelocityPublisher
    ) -> None:
        """Subscribe to the topic of `velocity`, to find commands of other publishers."""
        self._rate_hz = rate_hz
        self._control = control
        self._watchdog = watchdog
        foreign = ForeignCommands(
            velocity.gid,
            velocity.name_of,
            lambda: control.state.mode is Mode.MOVING,
            control.dispatch,
        )
        self.look_at_commands = velocity.monitor(
            foreign.heard, None if rate_hz >= LOOKS_ENOUGH_HZ else COMMAND_LATENCY_S
        )

    async def run(self, look_at_odometry: Callable[[], None]) -> None:
        """In each period, handle commands of others, odometry, then a tick, until cancelled."""

        def decide(tick: LoopTick) -> None:
            self.look_at_commands()
            look_at_odometry()
            self._control.dispatch(Tick(tick.t_ns, tick.missed))
            self._watchdog.ping()

        await Ticker(self._rate_hz).run(decide)
