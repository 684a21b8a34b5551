"""Pair each recorded velocity command with its decision in the journal, by number and value.

Decided commands, and zeros of the watchdog during a stall, have consecutive sequence numbers. The
last zeros of a daemon that fails have no decision.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from math import inf
from typing import Final, NamedTuple

from robotctl.base.errors import UnreadableFile
from robotctl.check.ends import Ending, EndingOf, JournalEnd
from robotctl.check.journal import Moments
from robotctl.check.report import Report
from robotctl.check.times import ClockChanges
from robotctl.check.topics import RepeatedLatched, RobotTopics, Slot, Waiting
from robotctl.kernel.codec import Proof, Snapshot
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.state import Health
from robotctl.kernel.types import (
    CommandPublishersSeen,
    Effect,
    Event,
    FaultReported,
    ForeignCommandHeard,
    LoopStalled,
    PublishTwist,
    Tick,
    Twist,
)
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.recording.read.messages import Message

_NUMBERS = struct.Struct("<6d")
_BIG_ENDIAN_NUMBERS = struct.Struct(">6d")
"""The six velocities at the end of a CDR-serialized Twist, by byte order (OMG DDSI-RTPS 10.2)."""

STILL = bytes(_NUMBERS.size)
"""The six numbers of a zero command."""


def numbers_of(data: bytes) -> bytes:
    """Return the six numbers of a Twist as little-endian bytes.

    Raises:
        UnreadableFile: The message is too short.
    """
    numbers = data[-_NUMBERS.size :]
    if len(numbers) < _NUMBERS.size:
        raise UnreadableFile("a velocity command is cut short")
    is_big = data[1:2] == b"\x00"
    return _NUMBERS.pack(*_BIG_ENDIAN_NUMBERS.unpack(numbers)) if is_big else numbers


def is_zero(numbers: bytes) -> bool:
    """Return whether the numbers command no motion; a negative zero is a zero."""
    return numbers == STILL or not any(_NUMBERS.unpack(numbers))


def serialized(twist: Twist) -> bytes:
    """Return the six numbers of a command as little-endian bytes."""
    return _NUMBERS.pack(twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)


def shown_command(numbers: bytes) -> str:
    """Return forward and turning velocity of a command, given by its six `numbers`, as text."""
    linear, _, _, _, _, angular = _NUMBERS.unpack(numbers)
    return f"{linear:.6g} m/s, {angular:.6g} rad/s"


LATE_NS: Final = NS_PER_S // 2
"""The tolerance for the time of a command, before and after its step."""

MAX_LATE: Final = 20_000
"""The maximum number of kept commands outside of their step, the newest ones."""

NEAR_NS: Final = 5 * NS_PER_S
"""A command this close to another publisher's presence may be from that publisher."""

LAST_ZEROS: Final = 2
"""The maximum number of zeros of a failing daemon after the last decision."""

ZERO_PERIOD_NS: Final = NS_PER_S // 25
"""A lower bound of the watchdog's period, which is 50 ms."""

STALL_NS: Final = 10 * NS_PER_S
"""The longest stall at the end of the recording."""

MAX_ZEROS: Final = 20_000
"""The maximum number of compared zeros of a stall."""

JOURNAL_LAG_NS: Final = NS_PER_S
"""The maximum lag of a robot's received journal behind the recorded commands."""

EDGE_NS: Final = 2 * NS_PER_S
"""A command from before the first snapshot may be recorded this long after that snapshot.

The message of a command decided this long before the end may be missing.
"""

RECENT: Final = 64
"""The maximum number of commands that one stall may withhold."""

CUT: Final = 3
"""The maximum number of commands whose decision is after a clip's end."""

SEND_FAILED: Final = f"{PublishTwist.__name__} failed"
"""Part of the detail of a fault about a command that could not be sent."""


def follows(number: int, other: int) -> bool:
    """Return whether `number` comes after `other`; numbers start again after MAX_SEQUENCE."""
    return 0 < (number - other) & MAX_SEQUENCE <= MAX_SEQUENCE // 2


@dataclass(slots=True)
class DecidedCommand:
    """A command in the journal: its six velocities (`numbers`), and the times of its step.

    `withheld` has the times of a stall in which the watchdog may have sent a zero instead.
    """

    numbers: bytes
    moments: Moments
    withheld: Moments | None = None


class SentCommand(NamedTuple):
    """A recorded velocity command, number `place`, after a journal event at steady time `t_ns`."""

    numbers: bytes
    publish_ns: int
    t_ns: int
    place: int


class OtherPublishers:
    """The periods with other publishers of commands, by the journal; steady times [ns]."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque(maxlen=10_000)
        """Begin and end of each period."""

    def begin(self, health: Health, t_ns: int) -> None:
        """Add the other publishers that the kernel knew at a snapshot, at steady time `t_ns`."""
        topic = health.command_topic
        if topic.foreign_t_ns is not None:
            self._seen.append((topic.foreign_t_ns, topic.foreign_t_ns))
        self.step(CommandPublishersSeen(t_ns, health.foreign_publishers))

    def step(self, event: Event) -> None:
        """Add the presence of other publishers, if `event` reports it."""
        is_there = bool(self._seen) and self._seen[-1][1] == inf
        if isinstance(event, ForeignCommandHeard) and not is_there:
            self._seen.append((event.t_ns, event.t_ns))
        elif isinstance(event, CommandPublishersSeen):
            if is_there:
                begin_ns, _ = self._seen.pop()
                self._seen.append((begin_ns, event.t_ns))
            if event.names:
                self._seen.append((event.t_ns, inf))

    def may_have_sent(self, t_ns: int) -> bool:
        """Return whether another publisher may have sent a command at the steady time `t_ns`."""
        return any(begin - NEAR_NS <= t_ns <= end + NEAR_NS for begin, end in self._seen)


@dataclass(slots=True)
class CommandCounts:
    """The number of commands of each kind, with first examples."""

    paired: int = 0
    missing: int = 0
    """Decided commands without a message, between others with one."""

    missing_example: str = ""
    before_first: int = 0
    """Decided commands without a message, before the first one with a message."""

    extra: int = 0
    """Messages without a decision and without a known sender."""

    extra_example: str = ""
    foreign: int = 0
    """Messages that another publisher may have sent."""

    foreign_example: str = ""
    after_end: int = 0
    """Messages after the end of a journal that was received from a robot."""

    undecided: int = 0
    """Messages at the end with a possible decision after the journal's end."""

    old: int = 0
    recent: int = 0
    """Decided commands at the end without a message: `old` by more than EDGE_NS, and `recent`."""

    out_of_order: int = 0
    resumed: int = 0
    """The number of snapshots with another count of commands than the journal before them."""

    unsent: bool = False
    """Whether the journal reports that a command could not be sent."""

    late: deque[tuple[int, str]] = field(default_factory=lambda: deque(maxlen=MAX_LATE))
    """The newest commands sent outside of their step: steady time [ns], and a description."""


class CommandPairs:
    """Compares decided and sent commands once a snapshot has a `Proof` (command count and CRC)."""

    def __init__(self, clip_begin_ns: float = 0.0) -> None:
        self.counts = CommandCounts()
        self._clip_begin_ns = clip_begin_ns
        self.is_counting = False
        self._others = OtherPublishers()
        self._waiting: Waiting[DecidedCommand, SentCommand] = Waiting(self._judge)
        self._recent: deque[DecidedCommand] = deque(maxlen=RECENT)
        self._has_ended = False
        """Whether the last snapshot counts zeros without a decision."""

        self._number = 0
        """The number of the last command in the journal or in its counts."""

        self._base = 0
        """The number of the last command before counting began, or 0."""

        self._base_ns = 0
        """The begin of counting (steady)."""

        self._paired: tuple[int, int] | None = None
        """The first and the newest paired number since counting began."""

        self._lacking = self._lacking_recent = 0
        self._lacking_example = ""
        """Count, recent count and example of decided commands after the last with a message."""

        self._t_ns = self._log_ns = self._tick_ns = 0
        """Time of the last event by the steady and the wall clock; steady time of the last tick."""

        self._places = self._last_place = 0
        """The number of messages, and the `place` of the message with the highest paired number."""

    def message(self, number: int, data: bytes, publish_ns: int) -> None:
        """Read a message of the command topic: sequence number, content, time of publishing.

        Raises:
            UnreadableFile: The message is too short.
        """
        if not self.is_counting:
            return
        is_early = self._t_ns - self._base_ns <= EDGE_NS
        if is_early and self._base and not follows(number, self._base):
            return  # it was decided before the recording began
        self._places += 1
        sent = SentCommand(numbers_of(data), publish_ns, self._t_ns, self._places)
        self._waiting.slot(number).sent.append(sent)

    def resume(self, proof: Proof, health: Health, t_ns: int) -> None:
        """Compare commands from a snapshot on; `proof` has the number of commands before it."""
        number = proof.commands & MAX_SEQUENCE
        more = (proof.commands - self._number) & MAX_SEQUENCE
        was_moving = bool(self._recent) and not is_zero(self._recent[-1].numbers)
        if self.is_counting and was_moving and 0 < more <= LAST_ZEROS:
            self._has_ended = True
            while number != self._number:
                self._decide(STILL, (self._t_ns, 0, 0))
            return
        self.counts.resumed += self.is_counting and bool(more)
        if not self.is_counting or more:
            self.stop()
            self._number = self._base = number
            self._base_ns = t_ns
            self._others.begin(health, t_ns)
            self.is_counting = True

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        for number, slot in self._waiting.rest():
            self._pair(number, slot)
        self.is_counting = False
        self._paired, self._last_place = None, 0
        self._recent.clear()
        self._lacking = self._lacking_recent = 0

    def step(self, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Read a journal step; each of its commands should have a recorded message."""
        if not self.is_counting:
            return
        self._t_ns, self._log_ns, _ = moments
        if self._has_ended:
            self.counts.resumed += 1
            self._has_ended = False
        self._others.step(event)
        if isinstance(event, Tick):
            self._tick_ns = event.t_ns
        elif isinstance(event, LoopStalled):
            self._stall(event, moments)
        elif isinstance(event, FaultReported) and SEND_FAILED in event.detail:
            self.counts.unsent = True  # which one is unknown; the next snapshot has the count
            self.stop()
            return
        for effect in effects:
            if isinstance(effect, PublishTwist):
                self._decide(serialized(effect.twist), moments)

    def _decide(self, numbers: bytes, moments: Moments) -> None:
        self._number = (self._number + 1) & MAX_SEQUENCE
        decided = DecidedCommand(numbers, moments)
        self._recent.append(decided)
        self._waiting.slot(self._number).entries.append(decided)

    def _stall(self, event: LoopStalled, moments: Moments) -> None:
        """Expect the zeros of the watchdog, and zeros in place of the withheld commands."""
        steady_ns, begin_ns, end_ns = moments
        began_ns = max(begin_ns - round(event.stalled_s * NS_PER_S), 1) if begin_ns else 0
        during = steady_ns, began_ns, end_ns
        withheld = event.withheld
        for decided in reversed(self._recent):
            if withheld <= 0:
                break
            decided.withheld = during
            withheld -= not is_zero(decided.numbers)
        self._recent.clear()
        for _ in range(min(event.zeros, MAX_ZEROS)):
            self._decide(STILL, during)

    def _judge(self, number: int, slot: Slot[DecidedCommand, SentCommand]) -> None:
        """Count the decisions and messages of one number without a counterpart."""
        for decided in self._pair(number, slot):
            self._lack(number, decided)
        self._doubt(slot.sent)

    def _pair(self, number: int, slot: Slot[DecidedCommand, SentCommand]) -> list[DecidedCommand]:
        """Pair decisions and messages of one number; return the decisions without a message."""
        lacking = []
        for decided in slot.entries:
            moments = decided.moments
            sent = next((each for each in slot.sent if _same(decided, each)), None)
            if decided.withheld is not None:
                zero = next((each for each in slot.sent if each.numbers == STILL), None)
                moments, sent = (decided.withheld, zero) if zero else (moments, sent)
            if sent is None:
                lacking.append(decided)
            else:
                slot.sent.remove(sent)
                self._found(number, moments, sent)
        return lacking

    def _found(self, number: int, moments: Moments, sent: SentCommand) -> None:
        """Count a pair, and a command that was sent early, late or out of order."""
        counts, (steady_ns, begin_ns, end_ns) = self.counts, moments
        is_late = end_ns and not begin_ns - LATE_NS <= sent.publish_ns <= end_ns + LATE_NS
        if is_late and self._others.may_have_sent(sent.t_ns):
            return  # a command of another publisher with the same number and velocity
        counts.paired += 1
        is_newest = self._paired is None or follows(number, self._paired[1])
        counts.out_of_order += is_newest is not (sent.place > self._last_place)
        if is_newest:
            if self._paired is None:
                counts.before_first += self._lacking
            elif self._lacking:
                counts.missing += self._lacking
                counts.missing_example = counts.missing_example or self._lacking_example
            self._paired = number if self._paired is None else self._paired[0], number
            self._last_place = sent.place
            self._lacking = self._lacking_recent = 0
        if is_late:
            off_s = max(begin_ns - sent.publish_ns, sent.publish_ns - end_ns) / NS_PER_S
            when = "before" if sent.publish_ns < begin_ns else "after"
            counts.late.append((steady_ns, f"command {number}, {off_s:.3f} s {when} its decision"))

    def _lack(self, number: int, decided: DecidedCommand) -> None:
        """Count a decision without a message."""
        counts, example = self.counts, f"command {number} ({shown_command(decided.numbers)})"
        is_first = self._paired is not None and follows(self._paired[0], number)
        if is_first or decided.moments[1] < self._clip_begin_ns:
            counts.before_first += 1
        elif self._paired is not None and not follows(number, self._paired[1]):
            counts.missing += 1
            counts.missing_example = counts.missing_example or example
        else:
            self._lacking_example = self._lacking_example if self._lacking else example
            self._lacking += 1
            self._lacking_recent += self._t_ns - decided.moments[0] <= EDGE_NS

    def _doubt(self, sent: Iterable[SentCommand], end_ns: float = inf) -> None:
        """Count messages without a decision; the journal ends at `end_ns`."""
        counts = self.counts
        for each in sent:
            example = shown_command(each.numbers)
            if self._others.may_have_sent(each.t_ns):
                counts.foreign += 1
                counts.foreign_example = counts.foreign_example or example
            elif each.t_ns < end_ns:
                counts.extra += 1
                counts.extra_example = counts.extra_example or example
            else:
                counts.after_end += 1

    def end(self, cut: int, *, is_own: bool, is_closed: bool) -> None:
        """Count the decided commands without a message, and the messages without a decision.

        Up to `cut` messages may be decided after the journal's end, as in a clip. A journal
        received from a robot (not `is_own`) may end before the last commands.
        """
        end_ns = inf if is_own else self._t_ns - JOURNAL_LAG_NS
        doubted: list[SentCommand] = []
        lacking: list[tuple[int, DecidedCommand]] = []
        for number, slot in self._waiting.rest():
            for decided in slot.entries:
                if not is_closed and decided.moments[0] >= self._tick_ns:  # it may end in a stall
                    decided.withheld = decided.withheld or decided.moments
            lacking += ((number, decided) for decided in self._pair(number, slot))
            if not slot.entries and follows(number, self._number):
                later = (number - self._number) & MAX_SEQUENCE
                for each in slot.sent:
                    if later <= cut or self._may_end_with(each, later, is_own):
                        slot.sent.remove(each)
                        self.counts.undecided += 1
                        break
            doubted += slot.sent
        for number, decided in lacking:
            self._lack(number, decided)
        self._doubt(doubted, end_ns)
        self.counts.recent = self._lacking_recent
        self.counts.old = self._lacking - self._lacking_recent

    def _may_end_with(self, message: SentCommand, later: int, is_own: bool) -> bool:
        """Return whether a message `later` numbers after the last decision may have no decision."""
        after_ns = message.publish_ns - self._log_ns
        if not is_own:
            return after_ns > -JOURNAL_LAG_NS
        return message.numbers == STILL and (
            later <= LAST_ZEROS or (later - LAST_ZEROS) * ZERO_PERIOD_NS <= after_ns <= STALL_NS
        )


def _same(decided: DecidedCommand, sent: SentCommand) -> bool:
    """Return whether a message carries the decided command; a negative zero is a zero."""
    return decided.numbers == sent.numbers or (sent.numbers == STILL and is_zero(decided.numbers))


class CommandCheck:
    """Compares commands with decisions by number; in a recording of 0.1.0, only counts commands."""

    def __init__(self, report: Report, topics: RobotTopics, clock: ClockChanges) -> None:
        self._topic = topics.commands
        self._report = report
        self._clock = clock
        self._pairs = CommandPairs(topics.clip_begin_ns)
        self._is_latched = topics.is_latched(self._topic)
        self._repeats = RepeatedLatched(topics.info)
        self._seen = 0

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler by topic name; {} if the topic is not recorded."""
        return {} if self._topic is None else {self._topic: self._message}

    def _message(self, message: Message) -> None:
        """Read a message of the command topic."""
        self._seen += 1
        if self._is_latched and (
            # A new file may repeat one that waits to be written: it is recorded after its repeat.
            message.log_ns < message.publish_ns
            or (self._pairs.is_counting and self._repeats.observe(message))
        ):
            return
        self._pairs.message(message.sequence, message.data, message.publish_ns)

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Begin or continue to compare if the snapshot has a `Proof` (command count and CRC)."""
        if snapshot.proof is not None:
            self._pairs.resume(snapshot.proof, snapshot.state.health, t_ns)

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        self._pairs.stop()

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare the commands of a step; `moments` are the times of its begin and its end."""
        self._clock.look(event.t_ns, moments[1])
        self._pairs.step(event, effects, moments)

    def end(self, ending_of: EndingOf, moment: JournalEnd) -> None:
        """Report the differences between commands and decisions."""
        self._report.commands = self._seen
        ending, notes, counts = ending_of(self._topic), self._report.notes, self._pairs.counts
        cut = CUT if ending.is_clip else 0
        self._pairs.end(cut, is_own=ending.is_own, is_closed=ending.is_closed)
        if counts.foreign:
            text = _without_decision(counts.foreign, counts.foreign_example)
            notes.append(
                f"{text}: {', '.join(sorted(ending.invariants.foreign))} published as well"
            )
        if counts.extra:
            ending.accuse(_without_decision(counts.extra, counts.extra_example))
        self._tell_missing(ending, counts)
        self._tell_end(ending, counts)
        if not ending.is_own:
            if after := counts.undecided + counts.after_end:
                notes.append(f"{after} commands are later than the journal that was received")
        elif counts.undecided and not ending.is_clip:
            notes.append(
                f"the last {counts.undecided} zeros have no decision: the recording ends before "
                "its journal tells of a stall or a failure"
            )
        late = [text for steady_ns, text in counts.late if not self._clock.is_near(steady_ns)]
        if late and ending.is_own:
            ending.accuse(f"{len(late)} commands were not sent when decided: {late[0]}")
        if counts.unsent:
            notes.append("the journal tells of commands that could not be sent")
        elif counts.resumed:
            self._report.miss("a snapshot counts other commands than were decided before it")
        # Another publisher may send a zero with our number; a file may repeat a latched one early.
        if counts.out_of_order and not counts.foreign and not self._is_latched:
            self._report.miss(
                f"{counts.out_of_order} commands are not in the order of their number"
            )

    def _tell_missing(self, ending: Ending, counts: CommandCounts) -> None:
        count = counts.missing + (0 if ending.is_clip else counts.before_first)
        if count:
            text = f"{count} decided commands are missing"
            if counts.missing_example:
                text += f", the first is {counts.missing_example}"
            ending.lack(count, text)

    def _tell_end(self, ending: Ending, counts: CommandCounts) -> None:
        is_closed = ending.is_closed and not ending.invariants.foreign
        count = counts.old + (counts.recent if is_closed else 0)
        is_known = self._topic or ending.is_own  # a robot that was observed may name it otherwise
        if is_known and count > max(ending.lost - counts.missing - counts.before_first, 0):
            if not counts.paired and is_closed and counts.old:
                ending.accuse(f"none of {count} decided commands is recorded")
            else:
                self._report.miss(f"the last {count} decided commands are missing")


def _without_decision(count: int, example: str) -> str:
    return f"{count} commands without a decision, such as {example}"
