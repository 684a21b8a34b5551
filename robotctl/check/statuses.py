"""Check the recorded RobotStatus messages against the journal: robot name, mode, missing ones."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Final

from robotctl.check.ends import Ending, EndingOf, JournalEnd
from robotctl.check.journal import Moments
from robotctl.check.report import Report
from robotctl.check.times import EXCUSES_NS, ClockChanges
from robotctl.check.topics import RepeatedLatched, RobotTopics
from robotctl.kernel.codec import Snapshot
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Effect, Event, ModeChanged
from robotctl.messages.cdr import ROBOT_STATUS, CdrReader
from robotctl.recording.read.messages import Message

FIRST_NS: Final = 2 * NS_PER_S
"""A recording with a journal longer than this must have a status."""

NEAR_NS: Final = NS_PER_S
"""The mode of a status must be in the journal within this time of the status."""

MAX_WAITING: Final = 10_000
"""The maximum number of waiting statuses, and of kept modes."""


@dataclass(slots=True)
class _ModeSpan:
    """A period in which the robot had a mode according to the journal; steady times [ns]."""

    mode: int
    begin_ns: int
    end_ns: float = inf


class ShownModes:
    """Counts the statuses with a wrong mode, in `wrong`.

    A mode is right if the journal has that mode within NEAR_NS of the status. Statuses near a
    change of the clock are not counted.
    """

    def __init__(self, clock: ClockChanges) -> None:
        self.wrong = 0
        self.example = ""
        self._clock = clock
        self._spans: deque[_ModeSpan] = deque(maxlen=MAX_WAITING)
        self._statuses: deque[tuple[int, int, int]] = deque(maxlen=MAX_WAITING)
        """Mode and steady time of each status, and steady time of the event before it."""

        self._t_ns = self._offset_ns = self._begin_ns = 0

    def snapshot(self, mode: Mode, t_ns: int, wall_ns: int) -> None:
        """Read mode and time of a snapshot; `t_ns` is steady, `wall_ns` since the epoch."""
        self._t_ns, self._offset_ns = t_ns, wall_ns - t_ns
        if not self._spans:
            self._spans.append(_ModeSpan(mode.value, t_ns))
            self._begin_ns = t_ns
        self._judge(t_ns - EXCUSES_NS)

    def status(self, mode: int, publish_ns: int) -> None:
        """Add the mode in a status, to be compared; `publish_ns` is its time since the epoch."""
        steady_ns = publish_ns - self._offset_ns
        if self._spans and steady_ns >= self._begin_ns:
            self._statuses.append((mode, steady_ns, self._t_ns))

    def step(self, t_ns: int, wall_ns: int) -> None:
        """Note the time of an event by both clocks."""
        self._t_ns, self._offset_ns = t_ns, wall_ns - t_ns

    def change(self, mode: Mode, moments: Moments) -> None:
        """Add a new mode; during its step, a status may show the old or the new mode."""
        t_ns, begin_ns, end_ns = moments
        if self._spans:
            self._spans[-1].end_ns = t_ns + max(end_ns - begin_ns, 0)
            self._spans.append(_ModeSpan(mode.value, t_ns))

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        self._spans.clear()
        self._statuses.clear()

    def end(self, *, is_closed: bool) -> None:
        """Compare the remaining statuses, up to the last event unless the recording `is_closed`."""
        self._judge(inf if is_closed else self._t_ns)

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
    """Compares robot statuses with the journal once a snapshot has a `Proof` (count and CRC)."""

    def __init__(self, report: Report, topics: RobotTopics, clock: ClockChanges) -> None:
        self._name, self._is_told = topics.told("topic.robot_status")
        recorded = topics.of_type(ROBOT_STATUS)
        self.topic = self._name if self._name in recorded else None
        self._others = sorted(recorded - {self._name})
        self.is_on = False
        self._report = report
        self._modes = ShownModes(clock)
        self._first = 0
        """The sequence number of the first status, or 0 before the first status."""

        self._newest = self._before = 0
        """The highest numbers, in total and of the copies before the first snapshot."""

        self._absent: set[int] = set()
        """The missing sequence numbers between the first and the newest status."""

        self._repeats = RepeatedLatched(topics.info)
        self._unordered = self._unordered_before = 0
        """The number of statuses out of order, in total and before the newest one."""

        self._foreign = 0
        """The number of statuses of other publishers on the topic."""

        self._misnamed: list[int] = []
        """The sequence numbers of the statuses with another robot name."""

        self._wrong = 0
        self._example = ""
        self._begin_ns = 0

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler by topic name; {} if the topic is not recorded."""
        return {} if self.topic is None else {self.topic: self._message}

    def _message(self, message: Message) -> None:
        """Check a status; skip the copies at the beginning of a file or clip."""
        if not self.is_on:
            self._before = max(message.sequence, self._before)
        # A recorder that lags may write a copy first: it then has the log time of the file's begin.
        if not self.is_on or message.log_ns < message.publish_ns:
            return
        if self._repeats.observe(message):
            if message.sequence == self._newest:
                self._unordered = self._unordered_before
            return
        try:
            reader = CdrReader(message.data)
            name, (mode,) = reader.text(), reader.take("B")
            reader.take("f", 2)  # battery level and temperature
            reader.take("?")  # whether odometry is fresh
        except struct.error:
            self._wrong += 1
            self._example = self._example or "one that cannot be read"
            return
        if self._report.robot and name != self._report.robot:
            self._misnamed.append(message.sequence)
            self._example = self._example or f"one of {name[:40]!r}"
        elif self._is_own(message.sequence):
            self._modes.status(mode, message.publish_ns)
        else:
            self._foreign += 1

    def _is_own(self, number: int) -> bool:
        """Add a sequence number; return False if another node sent the status."""
        if not self._first:
            self._first = self._newest = number
        elif number > self._newest:
            self._absent.update(range(self._newest + 1, min(number, self._newest + MAX_WAITING)))
            self._newest, self._unordered_before = number, self._unordered
        elif number in self._absent or number == self._newest:
            self._absent.discard(number)
            self._unordered += 1
        else:
            return False
        return True

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Begin or continue to compare if the snapshot has a `Proof` (command count and CRC)."""
        if snapshot.proof is None:
            return
        self._repeats.snapshot()
        if not self.is_on:
            self.is_on, self._begin_ns = True, log_ns
        self._modes.snapshot(snapshot.state.mode, t_ns, log_ns)

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Add the time of an event, and the change of mode among its effects."""
        self._modes.step(event.t_ns, moments[1])
        for effect in effects:
            if isinstance(effect, ModeChanged):
                self._modes.change(effect.mode, moments)

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        self._modes.stop()

    def end(self, ending_of: EndingOf, moment: JournalEnd) -> None:
        """Report the differences; call this at the end of the journal."""
        ending = ending_of(self.topic)
        if not self.is_on or not ending.is_own or ending.has_gaps:
            return
        if self.topic is None:
            self._tell_unrecorded(ending)
            return
        report, modes = self._report, self._modes
        modes.end(is_closed=ending.is_closed)
        gaps = sum(each > self._before for each in self._absent)
        gaps += self._first - 1 if self._first and ending.has_begin else 0
        is_mixed = self._unordered or self._foreign  # so the numbers are of two nodes
        own = {*self._absent, self._first - 1, max(self._newest, self._before) + 1}
        if (self._first or self._before) and (self._foreign or not own.issuperset(self._misnamed)):
            others = self._foreign + len(self._misnamed)
            report.notes.append(f"another node published robot statuses as well: {others} of its")
            self._foreign = others
        elif (wrong := self._wrong + len(self._misnamed) + modes.wrong) and not self._unordered:
            example = self._example or modes.example
            self._accuse(ending, f"{wrong} robot statuses are wrong: {example}")
        has_none = not self._first and moment.log_ns - self._begin_ns > FIRST_NS
        if gaps > ending.lost and ending.ledger is not None and not is_mixed:
            self._accuse(ending, f"{gaps} robot statuses are missing")
        elif has_none and ending.is_closed:
            self._accuse(ending, "no robot status is recorded")
        elif has_none and ending.is_whole:
            report.miss(f"no robot status is recorded; {ending.unknown_losses}")
        if self._unordered and not self._foreign:
            report.miss(
                f"{self._unordered} robot statuses are out of order, or another node publishes them"
            )
        if excess := self._repeats.excess:
            report.miss(f"{excess} robot statuses are repeated where no file begins")

    def _accuse(self, ending: Ending, text: str) -> None:
        if self._unordered or self._foreign:  # statuses of two nodes are not told apart
            self._report.miss(text)
        else:
            ending.accuse(text)

    def _tell_unrecorded(self, ending: Ending) -> None:
        text = f"its topic of robot statuses, {self._name}, is not recorded"
        if self._others and not self._is_told:
            self._report.notes.append(f"{text}: its name may be remapped, as {self._others[0]} is")
        elif self._is_told and ending.is_whole:
            self._report.miss(text)
