"""Check the times of a journal: order of measurements, missing ticks, clock changes, stalls."""

from __future__ import annotations

from itertools import accumulate
from typing import Final, NamedTuple

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    GuardedCommandReceived,
    LoopStalled,
    OdomReceived,
    SafetyInputReceived,
    ScanReceived,
    Tick,
)

MEASUREMENTS: Final = frozenset(
    {OdomReceived, BatteryReceived, ScanReceived, GuardedCommandReceived, SafetyInputReceived}
)
"""The events whose time `t_ns` is that of their message's receipt."""

SLACK_NS: Final = NS_PER_S // 1_000
"""The tolerance for a measurement that is earlier than one before it."""


class MeasurementOrder:
    """Checks that the times of measurements increase."""

    def __init__(self) -> None:
        self.swapped = 0
        """The number of measurements that are earlier than one before them."""

        self.first_seq = 0
        """The `seq` of the first swapped measurement, or 0."""

        self._newest_ns: int | None = None

    def step(self, event: Event, seq: int) -> None:
        """Compare the time of `event`, journal entry `seq`, with the times of earlier events."""
        if type(event) not in MEASUREMENTS:
            return
        if self._newest_ns is not None and event.t_ns < self._newest_ns - SLACK_NS:
            self.first_seq = self.first_seq or seq
            self.swapped += 1
        self._newest_ns = max(event.t_ns, self._newest_ns or event.t_ns)

    def stop(self) -> None:
        """Start over, after a gap in the journal."""
        self._newest_ns = None


WINDOW_NS: Final = NS_PER_S
"""A period in which even a busy loop handles at least one tick on time."""

LATE_NS: Final = NS_PER_S // 200
LATE_PERIODS: Final = 0.75
"""Limits on a lasting rise of lateness; above both, ticks are missing."""


class _Window(NamedTuple):
    """A part of the journal: its first tick (entry `seq`, at `t_ns`) and its smallest lateness."""

    late_ns: int
    seq: int
    t_ns: int


class MissingTicks(NamedTuple):
    """Ticks that are missing before an entry; `t_ns` is the steady time of that entry."""

    ticks: int
    seq: int
    t_ns: int


class TickSchedule:
    """Finds ticks that are missing in the journal: all recorded ticks after them seem late."""

    def __init__(self) -> None:
        self.missing: list[MissingTicks] = []
        self._period_ns = 0
        self._due_ns = 0
        self._least: _Window | None = None
        self._windows: list[_Window] = []

    def begin(self, rate_hz: float) -> None:
        """Set the rate of the ticks, which never changes in a recording."""
        self._period_ns = round(NS_PER_S / rate_hz)

    def step(self, event: Event, seq: int) -> None:
        """Read the lateness of a tick; `seq` is the number of its entry."""
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
        """Add the first ticks missing since the last call, if any, to `missing`, and start over.

        Call this before a gap in the journal, and at its end.
        """
        windows = self._windows if self._least is None else [*self._windows, self._least]
        before = accumulate(windows, min)
        after = [*accumulate(reversed(windows), min)][::-1]
        limit_ns = max(round(LATE_PERIODS * self._period_ns), LATE_NS)
        for earlier, window, later in zip(before, windows[1:-1], after[1:-1], strict=False):
            # Lateness often returns to its minimum, unless a tick is missing and not counted.
            late_ns = later.late_ns - earlier.late_ns
            if late_ns > limit_ns:
                ticks = max(round(late_ns / self._period_ns), 1)
                self.missing.append(MissingTicks(ticks, window.seq, window.t_ns))
                break
        self._due_ns, self._least, self._windows = 0, None, []


CLOCK_NS = NS_PER_S // 4
"""Smaller changes of the offset between the clocks are ignored."""

EXCUSES_NS = 2 * NS_PER_S
"""Wall-clock times are not compared within this time of a change."""


class _Step(NamedTuple):
    """A change of the offset by `by_ns` from `level_ns`."""

    by_ns: int
    level_ns: int


class ClockChanges:
    """Finds changes of the wall clock against the steady clock of the journal."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        """Wall clock - steady clock at the last moment."""

        self._wall_ns = 0
        self._changed_ns: list[int] = []
        self._set: list[_Step] = []

    @property
    def has_changed(self) -> bool:
        """Whether there was a change, by a stall or because the clock was set."""
        return bool(self._changed_ns)

    @property
    def note(self) -> str:
        """The sentence for the report if the clock was set, else ""."""
        if not self._set:
            return ""
        often = "once" if len(self._set) == 1 else f"{len(self._set)} times"
        by_s = self._set[0].by_ns / NS_PER_S
        return (
            f"the clock was set {often}, first by {by_s:+.2f} s: times around it are not compared"
        )

    def look(self, steady_ns: int, wall_ns: int) -> None:
        """Read the steady and the wall clock at one moment."""
        offset_ns, before_ns = wall_ns - steady_ns, self._offset_ns
        went_back, self._wall_ns = wall_ns < self._wall_ns, wall_ns
        self._offset_ns = offset_ns
        if before_ns is None:
            return
        by_ns = offset_ns - before_ns
        if abs(by_ns) > CLOCK_NS:
            self._changed_ns.append(steady_ns)
            # An entry may be recorded later than its event was stamped, never earlier.
            if by_ns > 0 or went_back:
                self._set.append(_Step(by_ns, before_ns))
                return
        while (
            self._set
            and self._set[-1].by_ns > 0
            and offset_ns <= self._set[-1].level_ns + CLOCK_NS  # as before the last rise
        ):
            self._set.pop()  # the rise was a stall

    def is_near(self, steady_ns: int) -> bool:
        """Return whether the offset between the clocks changed within EXCUSES_NS of this time."""
        return any(abs(steady_ns - at_ns) <= EXCUSES_NS for at_ns in self._changed_ns)


RECENT_NS: Final = 2 * NS_PER_S
"""A stall at most this long before the journal's end may have delayed its last inputs."""


class RecordedStalls:
    """Collects the stalls of the control loop; `longest_ns` is the longest duration of a stall."""

    def __init__(self) -> None:
        self.longest_ns = 0
        self._ends: list[tuple[int, int]] = []
        """The steady time of each stall's end, and its duration [ns]."""

    def step(self, event: Event) -> None:
        """Add the duration of a stall; ignore other events."""
        if isinstance(event, LoopStalled):
            stalled_ns = round(event.stalled_s * NS_PER_S)
            self.longest_ns = max(self.longest_ns, stalled_ns)
            self._ends.append((event.t_ns, stalled_ns))

    def recent_ns(self, end_ns: int) -> int:
        """Return the stalled time [ns] in the RECENT_NS before `end_ns`, at most RECENT_NS."""
        recent = (stalled_ns for t_ns, stalled_ns in self._ends if t_ns > end_ns - RECENT_NS)
        return min(sum(recent), RECENT_NS)
