"""The last layer inside the process: a thread that stops the robot when the loop does not turn."""

from __future__ import annotations

import logging
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, Self

from robotctl.daemon.processor_time import ProcessorTime

_log = logging.getLogger(__name__)

STALL_S = 0.1
"""A loop that has not ticked for so long has stalled..."""

CONFIRM_S = 0.02
"""...unless it ticks within this: a process that was not let run for a while catches up first."""

STALL_TICKS = 2.5
"""...unless its ticks lie so far apart that it may only be late."""

ZERO_PERIOD_S = 0.05
"""How often the thread repeats the zero while the loop stalls."""


class Gate(Protocol):
    """What stands between the loop and the robot; both calls come from the watchdog's thread."""

    def close_gate(self) -> None:
        """Let only zeros through from now on."""

    def publish_zero(self) -> None:
        """Send a zero, past the loop."""


@dataclass(frozen=True, slots=True)
class Turn:
    """When the loop turned, and how long its thread had waited for a processor until then."""

    t_ns: int
    waited_ns: int


class Watchdog:
    """Watches the ticks from a thread, from the first `ping` to the end of the `with` block.

    While others have the processors that it waits for, a loop does not stall; but after
    `patience_s` without a tick it counts as stalled whatever held it up. When the ticks stop it
    closes the gate, sends zeros and calls `on_stall(detail)` once, from its thread. It watches
    again after `taken`. A C call that holds the GIL holds this thread as well: then the robot's
    own command timeout is the last layer.
    """

    def __init__(
        self, rate_hz: float, patience_s: float, gate: Gate, on_stall: Callable[[str], None]
    ) -> None:
        self._limit_ns = round(max(STALL_S, STALL_TICKS / rate_hz) * 1e9)
        self._patience_ns = max(round(patience_s * 1e9), self._limit_ns)
        self._gate = gate
        self._on_stall = on_stall
        self._last = Turn(0, 0)
        self._taken = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def __enter__(self) -> Self:
        self._watched = threading.get_ident()
        self._processor = ProcessorTime()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._processor.close()

    def ping(self) -> None:
        """The loop turns: it has just carried out a tick."""
        self._last = self._now()
        if self._thread.ident is None:
            self._thread.start()

    def taken(self) -> None:
        """The kernel knows of the stall, and the loop turns again."""
        self._last = self._now()
        self._taken = True

    def _watch(self) -> None:
        while not self._ended.wait(self._due_s()):
            if not self._is_due():  # it has ticked in time
                continue
            while self._is_due() and not self._is_impatient() and self._processor.is_starved():
                pass
            self._ended.wait(CONFIRM_S)
            if self._is_due():
                self._hold()

    def _is_due(self) -> bool:
        return self._due_s() <= 0.0 and not self._ended.is_set()

    def _is_impatient(self) -> bool:
        return self._silent_ns() >= self._patience_ns

    def _now(self) -> Turn:
        return Turn(time.monotonic_ns(), self._processor.waited_ns())

    def _silent_ns(self) -> int:
        """Since the last tick."""
        return self._now().t_ns - self._last.t_ns

    def _due_s(self) -> float:
        """Seconds until the loop counts as stalled, negative when it does."""
        now, last = self._now(), self._last
        allowed_ns = self._limit_ns + now.waited_ns - last.waited_ns
        return (last.t_ns + min(allowed_ns, self._patience_ns) - now.t_ns) / 1e9

    def _hold(self) -> None:
        """Send zeros until the kernel has taken the stall over."""
        self._taken = False
        self._gate.close_gate()
        self._send_zero()
        silent_s = self._silent_ns() / 1e9
        _log.error("the loop stalls: no tick for %.2f s, at\n%s", silent_s, self._where())
        self._on_stall(f"the control loop stalled for more than {silent_s:.2f} s")
        while not self._taken and not self._ended.wait(ZERO_PERIOD_S):
            self._send_zero()

    def _send_zero(self) -> None:
        try:
            self._gate.publish_zero()
        except Exception:  # noqa: BLE001 - the next zero may pass; the thread must live
            _log.exception("the watchdog could not send a zero")

    def _where(self) -> str:
        frame = sys._current_frames().get(self._watched)
        return "".join(traceback.format_stack(frame, limit=8)) if frame else "unknown"
