"""Checks that the ticks of a journal keep to their schedule: after a removed tick all are late.

The control loop ticks at multiples of the period, each time a little late, and counts the ticks
that it missed. So the lateness often returns to its minimum. After a tick that was removed from the
journal, or was missed and not counted, it stays one period above that minimum.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Final, NamedTuple

from robotctl.kernel.types import Event, Tick
from robotctl.kernel.units import NS_PER_S

WINDOW_NS: Final = NS_PER_S
"""Even a busy loop handles one tick on time within this period."""

LATE_NS: Final = NS_PER_S // 200
LATE_PERIODS: Final = 0.75
"""How late the ticks must stay, whichever is more."""


class _Window(NamedTuple):
    """The least lateness in a part of the journal, which begins with a tick of this entry."""

    late_ns: int
    seq: int
    t_ns: int


class MissingTicks(NamedTuple):
    """Ticks that are missing before an entry; `t_ns` is the steady time of that entry."""

    ticks: int
    seq: int
    t_ns: int


class TickSchedule:
    """The lateness of the ticks, from a snapshot on."""

    def __init__(self) -> None:
        self.missing: list[MissingTicks] = []
        self._period_ns = 0
        self._due_ns = 0
        self._least: _Window | None = None
        self._windows: list[_Window] = []

    def begin(self, rate_hz: float) -> None:
        """Take the rate of the ticks; it never changes in a recording."""
        self._period_ns = round(NS_PER_S / rate_hz)

    def step(self, event: Event, seq: int) -> None:
        """Take an event, with the number of its entry."""
        if not isinstance(event, Tick) or not self._period_ns:
            return
        self._due_ns += (event.missed + 1) * self._period_ns
        late_ns, least = event.t_ns - self._due_ns, self._least
        if least is None:
            self._least = _Window(late_ns, seq, event.t_ns)
        elif event.t_ns - least.t_ns >= WINDOW_NS:
            self._windows.append(least)
            self._least = _Window(late_ns, seq, event.t_ns)
        elif late_ns < least.late_ns:
            self._least = least._replace(late_ns=late_ns)

    def stop(self) -> None:
        """Judge what was taken, and begin again: events are missing, or the journal ends.

        The last window is too short to judge it alone.
        """
        windows = self._windows if self._least is None else [*self._windows, self._least]
        before = accumulate(windows, min)
        after = [*accumulate(reversed(windows), min)][::-1]
        limit_ns = max(round(LATE_PERIODS * self._period_ns), LATE_NS)
        for earlier, window, later in zip(before, windows[1:-1], after[1:-1], strict=False):
            late_ns = later.late_ns - earlier.late_ns
            if late_ns > limit_ns:
                ticks = max(round(late_ns / self._period_ns), 1)
                self.missing.append(MissingTicks(ticks, window.seq, window.t_ns))
                break
        self._due_ns, self._least, self._windows = 0, None, []
