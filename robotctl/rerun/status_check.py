"""Checks the robot statuses against the journal: the robot, the mode, and that none is missing."""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass
from math import inf
from typing import Final

from robotctl.kernel.codec import Snapshot
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Effect, Event, ModeChanged
from robotctl.kernel.units import NS_PER_S
from robotctl.messages.cdr import ROBOT_STATUS, CdrReader
from robotctl.recording import RecordingInfo
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import EXCUSES_NS, ClockChanges
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.own_topics import RepeatedLatched, own_name
from robotctl.rerun.recording_ends import Ending

FIRST_NS: Final = 2 * NS_PER_S
"""A journal longer than this must have a status."""

NEAR_NS: Final = NS_PER_S
"""The mode of a status must be in the journal within this time of the status."""

MAX_WAITING: Final = 10_000
"""How many statuses may wait for later journal entries, and how many modes are kept."""


@dataclass(slots=True)
class _ModeSpan:
    """A period in which the robot had a mode according to the journal; steady times [ns]."""

    mode: int
    begin_ns: int
    end_ns: float = inf


class ShownModes:
    """Compares the modes in the statuses with those in the journal, from a snapshot on.

    `wrong` counts the statuses with a mode that the robot did not have within NEAR_NS of them,
    according to the journal. Statuses near a change of the clock are not counted.
    """

    def __init__(self, clock: ClockChanges) -> None:
        self.wrong = 0
        self.example = ""
        self._clock = clock
        self._spans: deque[_ModeSpan] = deque(maxlen=MAX_WAITING)
        self._statuses: deque[tuple[int, int, int]] = deque(maxlen=MAX_WAITING)
        """Mode and steady time of each status, and steady time of the event read before it."""

        self._t_ns = self._offset_ns = self._begin_ns = 0

    def snapshot(self, mode: Mode, t_ns: int, wall_ns: int) -> None:
        """Continue from a snapshot at the steady time `t_ns`, or `wall_ns` since the epoch."""
        self._t_ns, self._offset_ns = t_ns, wall_ns - t_ns
        if not self._spans:
            self._spans.append(_ModeSpan(mode.value, t_ns))
            self._begin_ns = t_ns
        self._judge(t_ns - EXCUSES_NS)

    def status(self, mode: int, publish_ns: int) -> None:
        """Keep a status, sent at `publish_ns` since the epoch, until it can be compared."""
        steady_ns = publish_ns - self._offset_ns
        if self._spans and steady_ns >= self._begin_ns:
            self._statuses.append((mode, steady_ns, self._t_ns))

    def step(self, t_ns: int, wall_ns: int) -> None:
        """Note the time of an event by both clocks."""
        self._t_ns, self._offset_ns = t_ns, wall_ns - t_ns

    def change(self, mode: Mode, moments: Moments) -> None:
        """Note a new mode; a status may show the old mode or the new one until the step ends."""
        t_ns, begin_ns, end_ns = moments
        if self._spans:
            self._spans[-1].end_ns = t_ns + max(end_ns - begin_ns, 0)
            self._spans.append(_ModeSpan(mode.value, t_ns))

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._spans.clear()
        self._statuses.clear()

    def end(self) -> None:
        """Compare the statuses that still wait, because the journal ends."""
        self._judge(inf)

    def _judge(self, until_ns: float) -> None:
        spans = self._spans
        while self._statuses and self._statuses[0][1] < until_ns:
            mode, at_ns, seen_ns = self._statuses.popleft()
            is_then = any(
                span.begin_ns - NEAR_NS <= at_ns <= span.end_ns + NEAR_NS and span.mode == mode
                for span in spans
            )
            if not is_then and not any(map(self._clock.is_near, (at_ns, seen_ns))):
                self.wrong += 1
                name = Mode(mode).name if mode in [each.value for each in Mode] else str(mode)
                self.example = self.example or (
                    f"one shows the mode {name}, which was not the mode then"
                )
        while len(spans) > 1 and spans[0].end_ns + NEAR_NS < until_ns - NEAR_NS:
            spans.popleft()


class StatusCheck:
    """Compares the statuses with the modes in the journal, from its first snapshot on."""

    def __init__(
        self, report: Report, info: RecordingInfo, journal_topic: str, clock: ClockChanges
    ) -> None:
        self._name, self._is_told = own_name(info, journal_topic, "topic.robot_status")
        recorded = {topic.name for topic in info.topics if topic.type_name == ROBOT_STATUS}
        self.topic = self._name if self._name in recorded else None
        self._others = sorted(recorded - {self._name})
        self.is_on = False
        self._report = report
        self._modes = ShownModes(clock)
        self._first = 1
        """The number of the first status."""

        self._newest = 0
        self._gaps = 0
        self._seen = 0
        self._repeats = RepeatedLatched(info)
        self._unordered = 0
        self._wrong = 0
        self._example = ""
        self._begin_ns = 0

    def message(self, message: Message) -> None:
        """Check a status; skip the repeat of the last one, with which each file and clip begins.

        If the recorder lags, this repeat may come before its original: then its log time, that of
        the file's beginning, is before its publish time.
        """
        if message.log_ns < message.publish_ns:
            self._repeats.count()
            return
        if self._repeats.observe(message):
            return
        try:
            reader = CdrReader(message.data)
            name, (mode,) = reader.text(), reader.take("B")
            reader.take("f", 2)  # battery level and temperature
            reader.take("?")  # whether odometry is fresh
        except struct.error:
            self._blame("one that cannot be read")
            return
        if not self._seen:
            self._first = message.sequence
        self._gaps += max(message.sequence - self._newest - 1, 0) if self._seen else 0
        self._unordered += message.sequence <= self._newest
        self._newest = message.sequence
        self._seen += 1
        if self._report.robot and name != self._report.robot:
            self._blame(f"one of {name[:40]!r}")
        self._modes.status(mode, message.publish_ns)

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Continue from a snapshot at the steady time `t_ns`, or `log_ns` since the epoch."""
        if snapshot.proof is None:
            return
        self._repeats.snapshot()
        if not self.is_on:
            self.is_on, self._begin_ns = True, log_ns
        self._modes.snapshot(snapshot.state.mode, t_ns, log_ns)

    def step(self, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Note the time of an event, and the new mode if it changed the mode."""
        self._modes.step(event.t_ns, moments[1])
        for effect in effects:
            if isinstance(effect, ModeChanged):
                self._modes.change(effect.mode, moments)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._modes.stop()

    def end(self, invariants: Invariants, ending: Ending, end_ns: int) -> None:
        """Report what differs; the journal ends at `end_ns` since the epoch."""
        if not self.is_on or not ending.is_own or self._report.has_gaps:
            return
        if self.topic is None:
            self._tell_unrecorded(ending)
            return
        report, modes = self._report, self._modes
        modes.end()
        if ending.has_begin:
            self._gaps += self._first - 1
        wrong = self._wrong + modes.wrong
        if wrong:
            example = self._example or modes.example
            self._accuse(invariants, ending, f"{wrong} robot statuses are wrong: {example}")
        missing = []
        if self._gaps > ending.lost and ending.ledger is not None:
            missing.append(f"{self._gaps} robot statuses are missing")
        elif not self._seen and ending.is_whole and end_ns - self._begin_ns > FIRST_NS:
            missing.append("no robot status is recorded")
        for text in missing:
            if ending.ledger is None:
                report.miss(f"{text}; {ending.unknown_losses}")
            else:
                self._accuse(invariants, ending, text)
        if self._unordered:
            report.miss(f"{self._unordered} robot statuses are out of order")
        if excess := self._repeats.excess:
            report.miss(f"{excess} robot statuses are repeated where no file begins")

    def _accuse(self, invariants: Invariants, ending: Ending, text: str) -> None:
        if self._unordered:  # another node publishes them as well: they are not told apart
            self._report.miss(text)
        else:
            ending.accuse(self._report, invariants, text)

    def _tell_unrecorded(self, ending: Ending) -> None:
        text = f"its topic of robot statuses, {self._name}, is not recorded"
        if self._others and not self._is_told:
            self._report.notes.append(f"{text}: its name may be remapped, as {self._others[0]} is")
        elif self._is_told and ending.is_whole:
            self._report.miss(text)

    def _blame(self, text: str) -> None:
        self._wrong += 1
        self._example = self._example or text
