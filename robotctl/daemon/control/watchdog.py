"""The last layer inside the process: a thread that stops the robot when the loop does not turn."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Protocol, Self

from robotctl.daemon.control.processor_wait import ProcessorWait, pressure
from robotctl.kernel.types import Cause, FaultReported, LoopStalled
from robotctl.kernel.units import NS_PER_S

STALL_S = 0.1
"""A loop that has not ticked for this long has stalled..."""

CONFIRM_S = 0.02
"""...unless it ticks within this: after a pause of the whole process the loop catches up first."""

STALL_TICKS = 2.5
"""...unless its ticks lie so far apart that it may only be late."""

ZERO_PERIOD_S = 0.05
"""How often the thread repeats the zero while the loop stalls."""

SHOWN_FRAMES = 3
"""How much of the stack a stall names: the innermost calls."""

BUSY_SHARE = 0.5
"""A loop that waited for a processor for more of its stall than this was held up by others."""


class Gate(Protocol):
    """What stands between the loop and the robot."""

    def close_gate(self) -> None:
        """Let only zeros through from now on; called by the watchdog's thread."""

    def publish_zero(self) -> None:
        """Send a zero past the loop while the gate is closed; called by the watchdog's thread."""

    def open_gate(self) -> tuple[int, int]:
        """Let commands through; return the zeros that were sent and the commands withheld."""


@dataclass(frozen=True, slots=True)
class LoopTick:
    """When the loop turned, and how long its thread had waited for a processor until then."""

    t_ns: int
    waited_ns: int


class Watchdog:
    """Watches the ticks from a thread, from the first `ping` to the end of the `with` block.

    When the ticks stop it closes the gate and sends zeros until the loop calls `take`. Before the
    first zero is out, the thread opens no file, imports nothing, logs nothing and takes no lock but
    the publisher's own, which it waits for at most `LOCK_TIMEOUT_S`. A C call that holds the GIL
    holds this thread as well: then the robot's own command timeout is the last layer.
    """

    def __init__(
        self,
        rate_hz: float,
        gate: Gate,
        now_ns: Callable[[], int] = time.monotonic_ns,
        ended: threading.Event | None = None,
    ) -> None:
        """`ended` is set at the end of the block; the thread waits by its `wait` alone."""
        self._limit_ns = round(max(STALL_S, STALL_TICKS / rate_hz) * NS_PER_S)
        self._gate = gate
        self._now_ns = now_ns
        self._last = LoopTick(0, 0)
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
        """Note that the loop turns: it has just carried out a tick."""
        self._last = self._now()
        if self._thread.ident is None:
            self._thread.start()

    def take(self) -> LoopStalled | FaultReported | None:
        """Return what the kernel must know before anything else, each once; open the gate.

        Belongs to the loop's thread.
        """
        if self._holding:
            return self._end_stall()
        if self._failure:
            detail, self._failure = self._failure, ""
            return FaultReported(self._now_ns(), Cause.TASK_DIED, detail)
        return None

    # In the loop's thread

    def _end_stall(self) -> LoopStalled:
        now, last = self._now(), self._last
        zeros, withheld = self._gate.open_gate()
        self._holding = False  # a stall without a tick since goes on: only `ping` ends it
        stalled_s = (now.t_ns - last.t_ns) / NS_PER_S
        waited_s = (now.waited_ns - last.waited_ns) / NS_PER_S
        if waited_s > BUSY_SHARE * stalled_s:
            detail = f"the machine was busy: no processor for {waited_s:.2f} s{pressure()}"
        else:
            detail = f"in {self._where}" if self._where else "the loop was held up"
        if self._unsent:
            detail = f"{detail}; {self._unsent} zeros could not be sent"
            self._unsent = 0
        return LoopStalled(now.t_ns, stalled_s, zeros, withheld, detail)

    # In the watchdog's thread

    def _run(self) -> None:
        try:
            self._watch()
        except BaseException as error:  # noqa: BLE001 - the loop must learn of it, whatever it was
            self._failure = "the watchdog failed"
            self._failure = f"the watchdog failed ({type(error).__name__}: {error})"

    def _watch(self) -> None:
        while not self._ended.wait(self._due_s()):
            if not self._is_due():  # it has ticked in time
                continue
            self._ended.wait(CONFIRM_S)
            if self._is_due():
                self._hold()

    def _is_due(self) -> bool:
        return self._due_s() <= 0.0 and not self._ended.is_set()

    def _due_s(self) -> float:
        """Return the seconds until the loop counts as stalled, negative when it does."""
        return (self._last.t_ns + self._limit_ns - self._now_ns()) / NS_PER_S

    def _hold(self) -> None:
        """Send zeros until the loop has taken the stall."""
        self._where = ""
        self._gate.close_gate()
        self._holding = True
        self._send_zero()
        self._where = where(sys._current_frames().get(self._watched))
        while self._holding and not self._ended.wait(ZERO_PERIOD_S):
            self._send_zero()

    def _send_zero(self) -> None:
        try:
            self._gate.publish_zero()
        except Exception:  # noqa: BLE001 - the next zero may pass; the thread must live
            self._unsent += 1

    def _now(self) -> LoopTick:
        return LoopTick(self._now_ns(), self._processor.waited_ns())


def where(frame: FrameType | None) -> str:
    """Return the innermost calls of a stack, from names alone: no source file is opened."""
    calls: list[str] = []
    while frame is not None and len(calls) < SHOWN_FRAMES:
        code = frame.f_code
        file = code.co_filename.rpartition("/")[2]
        calls.append(f"{code.co_qualname} ({file}:{frame.f_lineno})")
        frame = frame.f_back
    return ", called by ".join(calls)
