"""The last layer inside the process: a thread that stops the robot when the loop does not turn."""

from __future__ import annotations

import logging
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

_log = logging.getLogger(__name__)

STALL_S = 0.1
"""A loop that has not ticked for so long has stalled..."""

CONFIRM_S = 0.02
"""...unless it ticks within this: a process that was not let run for a while catches up first."""

STALL_TICKS = 2.5
"""...unless its ticks lie so far apart that it may only be late."""

ZERO_PERIOD_S = 0.05
"""How often the thread repeats the zero while the loop stalls."""

LOOK_S = 0.01
"""How long a look takes whether the loop's thread is given a processor."""

STARVED_SHARE = 0.1
"""A thread that wants to run, and runs for less of a look than this, is starved."""


class Gate(Protocol):
    """What stands between the loop and the robot; both calls come from the watchdog's thread."""

    def close_gate(self) -> None:
        """Let only zeros through from now on."""

    def publish_zero(self) -> None:
        """Send a zero, past the loop."""


class Watchdog:
    """Watches the ticks from a thread, from the first `ping` to the end of the `with` block.

    A loop that wants to run while others have the processors is given `patience_s` before it
    counts as stalled. When the ticks stop it closes the gate, sends zeros and calls
    `on_stall(detail)` once, from its thread. It watches again after `taken`. A C call that holds
    the GIL holds this thread as well: then the robot's own command timeout is the last layer.
    """

    def __init__(
        self, rate_hz: float, patience_s: float, gate: Gate, on_stall: Callable[[str], None]
    ) -> None:
        self._limit_ns = round(max(STALL_S, STALL_TICKS / rate_hz) * 1e9)
        self._patience_s = patience_s
        self._gate = gate
        self._on_stall = on_stall
        self._last_ns = 0
        self._taken = False
        self._ended = threading.Event()
        self._watched = threading.get_ident()
        self._clock = time.pthread_getcpuclockid(self._watched)
        self._stat = Path(f"/proc/self/task/{threading.get_native_id()}/stat")
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def ping(self) -> None:
        """The loop turns: it has just carried out a tick."""
        self._last_ns = time.monotonic_ns()
        if self._thread.ident is None:
            self._thread.start()

    def taken(self) -> None:
        """The kernel knows of the stall, and the loop turns again."""
        self._last_ns = time.monotonic_ns()
        self._taken = True

    def _watch(self) -> None:
        while not self._ended.wait(self._due_s()):
            while self._is_due() and self._silent_s() < self._patience_s and self._is_starved():
                pass
            self._ended.wait(CONFIRM_S)
            if self._is_due():
                self._hold()

    def _is_due(self) -> bool:
        return self._due_s() <= 0.0 and not self._ended.is_set()

    def _is_starved(self) -> bool:
        """Look for a while whether the loop's thread wants to run and is not let."""
        if not self._wants_to_run():
            return False
        before_ns = time.clock_gettime_ns(self._clock)
        self._ended.wait(LOOK_S)
        ran_s = (time.clock_gettime_ns(self._clock) - before_ns) / 1e9
        return self._wants_to_run() and ran_s < STARVED_SHARE * LOOK_S

    def _wants_to_run(self) -> bool:
        """Say whether the thread is in state R, running or about to (proc(5))."""
        return self._stat.read_text().rpartition(")")[2].split()[0] == "R"

    def _silent_s(self) -> float:
        """Seconds since the last tick."""
        return (time.monotonic_ns() - self._last_ns) / 1e9

    def _due_s(self) -> float:
        """Seconds until the loop counts as stalled, negative when it does."""
        return (self._last_ns + self._limit_ns - time.monotonic_ns()) / 1e9

    def _hold(self) -> None:
        """Send zeros until the kernel has taken the stall over."""
        self._taken = False
        self._gate.close_gate()
        self._send_zero()
        silent_s = self._silent_s()
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
