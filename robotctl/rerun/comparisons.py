"""Compares everything that a check can compare with the decisions of a journal, step by step."""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import Final, NamedTuple, Protocol

from robotctl.kernel.codec import Snapshot
from robotctl.kernel.types import (
    BatteryReceived,
    Effect,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    SafetyInputReceived,
    ScanReceived,
    Tick,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import RecordingInfo
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges, RecordedStalls
from robotctl.rerun.commands import CommandCheck
from robotctl.rerun.ends import EndingOf, JournalEnd
from robotctl.rerun.inputs import InputChecks
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal import Moments
from robotctl.rerun.service_check import ServiceChecks
from robotctl.rerun.status_check import StatusCheck

MEASUREMENTS: Final = frozenset(
    {OdomReceived, BatteryReceived, ScanReceived, GuardedCommandReceived, SafetyInputReceived}
)
"""The events whose time is that of their reception."""

SLACK_NS: Final = NS_PER_S // 1_000
"""A measurement may be this much earlier than the newest one before it."""


class MeasurementOrder:
    """Checks that the times of measurements increase, in the order in which they were received.

    Ticks are not checked here, see `TickSchedule`.
    """

    def __init__(self) -> None:
        self.swapped = 0
        """The number of measurements that are earlier than one before them."""

        self.first_seq = 0
        """The `seq` of the first of these measurements."""

        self._newest_ns: int | None = None

    def step(self, event: Event, seq: int) -> None:
        """Compare the time of an event with those before; `seq` is the number of its entry."""
        if type(event) not in MEASUREMENTS:
            return
        if self._newest_ns is not None and event.t_ns < self._newest_ns - SLACK_NS:
            self.first_seq = self.first_seq or seq
            self.swapped += 1
        self._newest_ns = max(event.t_ns, self._newest_ns or event.t_ns)

    def stop(self) -> None:
        """Begin again: events are missing."""
        self._newest_ns = None


WINDOW_NS: Final = NS_PER_S
"""In any period of this length, even a busy loop handles at least one tick on time."""

LATE_NS: Final = NS_PER_S // 200
LATE_PERIODS: Final = 0.75
"""Ticks are missing if lateness stays higher by more than LATE_NS and by this many periods."""


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
    """Finds missing ticks by the lateness of the others, from a snapshot on.

    The control loop ticks at multiples of the period, each time a little late, and counts the ticks
    that it missed. So the lateness often returns to its minimum. After a tick that was removed from
    the journal, or was missed and not counted, it stays one period above that minimum.
    """

    def __init__(self) -> None:
        self.missing: list[MissingTicks] = []
        self._period_ns = 0
        self._due_ns = 0
        self._least: _Window | None = None
        self._windows: list[_Window] = []

    def begin(self, rate_hz: float) -> None:
        """Note the rate of the ticks, which never changes in a recording."""
        self._period_ns = round(NS_PER_S / rate_hz)

    def step(self, event: Event, seq: int) -> None:
        """Note how late a tick is; `seq` is the number of its entry."""
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
        """Look for missing ticks until here and start over: events are missing or the journal ends.

        The last window is too short to be judged alone.
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


class Compared(Protocol):
    """One of the comparisons of messages with a journal."""

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each topic that it reads."""

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Continue from a snapshot at the steady time `t_ns`, which is `log_ns` since the epoch."""

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare a step; `seq` is the number of its event, `moments` is when it was handled."""

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""

    def end(self, ending_of: EndingOf, moment: JournalEnd, /) -> None:
        """Report what differs."""


class Comparisons:
    """The invariants, and the comparisons of commands, inputs, services and statuses."""

    def __init__(
        self, report: Report, invariants: Invariants, info: RecordingInfo, journal_topic: str
    ) -> None:
        self._report = report
        self._invariants = invariants
        clock = self._clock = ClockChanges()
        self._stalls = RecordedStalls()
        self._ticks = TickSchedule()
        self._order = MeasurementOrder()
        about = report, info, journal_topic
        self._of_all: tuple[Compared, ...] = (
            InputChecks(*about, self._stalls),
            StatusCheck(*about, clock),
        )
        """What compares each step."""

        self._of_decisions: tuple[Compared, ...] = (
            CommandCheck(*about, clock),
            ServiceChecks(*about, clock),
        )
        """What compares all steps but odometry that led to nothing, which most steps are."""

    @property
    def _all(self) -> tuple[Compared, ...]:
        return self._of_decisions + self._of_all

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each topic that is compared."""
        return {topic: read for each in self._all for topic, read in each.readers().items()}

    def step_before_snapshot(self, event: Event, effects: tuple[Effect, ...]) -> None:
        """Note a step before the first snapshot, when the kernel's state is not known."""
        for each in self._of_decisions:
            each.step(0, event, effects, (0, 0, 0))

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Continue from a snapshot at the steady time `t_ns`, which is `log_ns` since the epoch."""
        self._invariants.snapshot(snapshot)
        self._ticks.begin(snapshot.params.rate_hz)
        for each in self._all:
            each.snapshot(snapshot, t_ns, log_ns)

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare a step; `seq` is the number of its event, `moments` is when it was handled."""
        self._order.step(event, seq)
        self._stalls.step(event)
        for each in self._of_all:
            each.step(seq, event, effects, moments)
        if not effects and isinstance(event, OdomReceived):
            return
        self._ticks.step(event, seq)
        for each in self._of_decisions:
            each.step(seq, event, effects, moments)
        self._invariants.step(seq, event, effects)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._invariants.stop()
        self._ticks.stop()
        self._order.stop()
        for each in self._all:
            each.stop()

    def end(self, ending: EndingOf, end_ns: int, log_ns: int) -> None:
        """Report what differs; the journal ends at `end_ns`, or at `log_ns` since the epoch."""
        self._ticks.stop()
        for found in self._ticks.missing:
            self._invariants.violate(f"{found.ticks} ticks are missing before entry {found.seq}")
        if swapped := self._order.swapped:
            text = f"{swapped} measurements are earlier than one before them"
            self._invariants.violate(f"{text}, the first is entry {self._order.first_seq}")
        stalled_ns = self._stalls.recent_ns(end_ns)
        moment = JournalEnd(end_ns, log_ns, stalled_ns, self._clock.has_changed)
        for each in self._all:
            each.end(ending, moment)
        if self._clock.note and ending(None).is_own:
            self._report.notes.append(self._clock.note)
