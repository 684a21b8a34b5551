"""Checks the robot statuses against the journal: name, mode, battery level, odometry."""

from __future__ import annotations

import struct
from math import inf

from robotctl.cdr.known_types import ROBOT_STATUS
from robotctl.cdr.reader import CdrReader
from robotctl.kernel.health import Health
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import BatteryReceived, Effect, Event, ModeChanged
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import RecordingInfo
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.ending import Ending
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.own_topics import own_name
from robotctl.rerun.repeated_latched import RepeatedLatched
from robotctl.rerun.status_times import RecordedStatus, StatusTimes

UNDER_WAY_NS = 2 * NS_PER_S
"""How long before the end a change of the mode may lack its status."""

_OTHER_REPEAT = "one that was recorded before it was sent differs from the one that was sent"


class StatusCheck:
    """The comparison of the statuses with the modes of the journal, from its first snapshot on."""

    def __init__(
        self, report: Report, info: RecordingInfo, journal_topic: str, clock: ClockChanges
    ) -> None:
        self._name, self._is_told = own_name(info, journal_topic, "topic.robot_status")
        recorded = {topic.name for topic in info.topics if topic.type_name == ROBOT_STATUS}
        self.topic = self._name if self._name in recorded else None
        self._others = sorted(recorded - {self._name})
        self.is_on = False
        self._report = report
        self._times = StatusTimes(clock)
        self._first = 1
        """The number of the first status."""

        self._newest = 0
        self._gaps = 0
        self._seen = 0
        self._repeats = RepeatedLatched(info)
        self._ahead: dict[int, bytes] = {}
        """Statuses that were recorded as repeats and have not arrived in order yet, by number."""

        self._unordered = 0
        self._wrong = 0
        self._example = ""
        self._begin_ns = 0

    def message(self, message: Message) -> None:
        """Take a status; the last one is repeated at the beginning of each file and clip.

        Where the recorder lags, the one it repeats is sent later, and comes again in the file.
        """
        if message.log_ns < message.publish_ns:
            if self._ahead.setdefault(message.sequence, message.data) != message.data:
                self._blame(_OTHER_REPEAT)
            self._repeats.count()
            return
        if self._ahead.pop(message.sequence, message.data) != message.data:
            self._blame(_OTHER_REPEAT)
        if self._repeats.take(message):
            return
        try:
            reader = CdrReader(message.data)
            name, (mode,) = reader.text(), reader.take("B")
            (level,) = reader.take("f")
            reader.take("f")  # the temperature
            (is_connected,) = reader.take("?")
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
        self._times.status(RecordedStatus(mode, level, is_connected, message.publish_ns))

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Continue from a snapshot, with its time by the steady clock and since the epoch."""
        if snapshot.proof is None:
            return
        self._repeats.snapshot()
        if not self.is_on:
            self.is_on, self._begin_ns = True, log_ns
        self._times.snapshot(snapshot, t_ns, log_ns)

    def step(
        self,
        event: Event,
        effects: tuple[Effect, ...],
        measured: Health | None,
        moments: Moments,
    ) -> None:
        """Take an event with its effects, and what is measured after it, if known."""
        if measured is not None:
            self._times.step(event.t_ns, moments[1], measured.odometry_t_ns)
            if isinstance(event, BatteryReceived):
                self._times.level(measured.battery_level, moments)
        for effect in effects:
            if isinstance(effect, ModeChanged):
                self._times.mode(effect.mode, moments)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._times.stop()

    def end(self, invariants: Invariants, ending: Ending, end_ns: int) -> None:
        """Report what differs; the journal ends at `end_ns` since the epoch."""
        if not self.is_on or not ending.is_own or self._report.has_gaps:
            return
        if self.topic is None:
            self._tell_unrecorded(ending)
            return
        report, times = self._report, self._times
        is_closed = ending.is_whole and ending.ledger is not None
        times.end(inf if is_closed else end_ns - UNDER_WAY_NS)
        if ending.has_begin:
            self._gaps += self._first - 1
        wrong = self._wrong + times.wrong
        if wrong:
            example = self._example or times.example
            self._accuse(invariants, ending, f"{wrong} robot statuses are wrong: {example}")
        lost = min(self._gaps, ending.lost) if is_closed else self._gaps
        missing = []
        if times.unshown > lost:
            missing.append(f"{times.unshown} changes of the mode are shown by no robot status then")
        if self._gaps > ending.lost and ending.ledger is not None:
            missing.append(f"{self._gaps} robot statuses are missing")
        elif not self._seen and ending.is_whole and end_ns - self._begin_ns > UNDER_WAY_NS:
            missing.append("no robot status is recorded")
        if self._ahead and ending.is_whole:
            missing.append(f"{len(self._ahead)} robot statuses are recorded before they were sent")
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
