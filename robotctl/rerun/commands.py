"""Pairs each recorded velocity command with its decision in the journal, by number and value.

Each decided command got the next sequence number of our publisher. So did each zero that the
watchdog sent in between; the journal has their count. So it is known which number carries which
velocity. A message with another number or velocity is another publisher's, or was not decided.

The watchdog sends its zeros while the control loop stalls; the journal has their count after the
stall. A daemon that fails sends its last zeros without a decision. If the recording ends too early,
its journal explains neither these zeros nor those of the watchdog.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from math import inf
from typing import Final, NamedTuple

from robotctl.base.errors import UnreadableFile
from robotctl.kernel.codec import Proof, Snapshot
from robotctl.kernel.command_types import COMMAND_TYPES
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
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import RecordingInfo
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.ends import Ending, EndingOf, JournalEnd
from robotctl.rerun.journal import Moments
from robotctl.rerun.own_topics import full_name

_NUMBERS = struct.Struct("<6d")
_BIG_ENDIAN_NUMBERS = struct.Struct(">6d")
"""The six velocities at the end of a CDR-serialized Twist, by byte order (OMG DDSI-RTPS 10.2)."""

STILL = bytes(_NUMBERS.size)
"""The six numbers of a zero command."""


def command_topic(info: RecordingInfo, journal_topic: str) -> str | None:
    """Return the command topic of the robot with this journal, None if it is not recorded."""
    name = full_name(info, journal_topic, "command.topic", "cmd_vel")
    recorded = {topic.name for topic in info.topics if topic.type_name in COMMAND_TYPES}
    return name if name in recorded else None


def numbers_of(data: bytes) -> bytes:
    """Return the six numbers of a Twist as little-endian bytes.

    Raises:
        UnreadableFile: The message is too short.
    """
    numbers = data[-_NUMBERS.size :]
    if len(numbers) < _NUMBERS.size:
        raise UnreadableFile("a velocity command is cut short")
    if data[1:2] == b"\x00":
        return _NUMBERS.pack(*_BIG_ENDIAN_NUMBERS.unpack(numbers))
    return numbers


def is_zero(numbers: bytes) -> bool:
    """Return whether these numbers command no motion; a negative zero commands none either."""
    return numbers == STILL or not any(_NUMBERS.unpack(numbers))


def serialized(twist: Twist) -> bytes:
    """Return the six numbers of a command as little-endian bytes."""
    return _NUMBERS.pack(twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)


def shown_command(numbers: bytes) -> str:
    """Return the velocities of a command as text."""
    linear, _, _, _, _, angular = _NUMBERS.unpack(numbers)
    return f"{linear:.6g} m/s, {angular:.6g} rad/s"


LATE_NS = NS_PER_S // 2
"""How long before or after its step a command may be sent."""

MAX_LATE = 20_000
"""Of the commands sent outside of their step, only this many are kept, the newest ones."""


class CommandCounts:
    """Counts paired and missing commands; knows the first and newest number since `begin_again`."""

    def __init__(self) -> None:
        self.paired = 0
        self.undecided = 0
        """The number of messages that may have been decided after the journal's end."""

        self.missing = 0
        """The number of decided commands without a message, between others that have one."""

        self.missing_example = ""
        self.before_first = 0
        """The number of decided commands without a message, before the first one with a message."""

        self.late: deque[tuple[int, str]] = deque(maxlen=MAX_LATE)
        """The newest commands sent outside of their step: steady time [ns], and a description."""

        self.out_of_order = 0
        """The number of paired commands that came after one with a higher number."""

        self.resumed = 0
        """How often a snapshot's count of commands was not that of the decisions before it."""

        self.unsent = False
        """Whether the journal reports that a command could not be sent."""

        self._first: int | None = None
        self._newest = 0

    @property
    def has_begun(self) -> bool:
        """Whether a command was paired since `begin_again`."""
        return self._first is not None

    def begin_again(self) -> None:
        """Forget which numbers were paired, because later commands may be numbered differently."""
        self._first = None

    def is_passed(self, number: int) -> bool:
        """Return whether `number` or a later one was paired."""
        return self._first is not None and not follows(number, self._newest)

    def pair(self, sequence: int, moments: Moments, publish_ns: int) -> None:
        """Count a command whose message was found, and describe it if it was early or late."""
        self.paired += 1
        if self._first is None:
            self._first = self._newest = sequence
        elif follows(sequence, self._newest):
            self._newest = sequence
        else:
            self.out_of_order += 1
        steady_ns, begin_ns, end_ns = moments
        if end_ns and not begin_ns - LATE_NS <= publish_ns <= end_ns + LATE_NS:
            off_s = max(begin_ns - publish_ns, publish_ns - end_ns) / NS_PER_S
            when = "before" if publish_ns < begin_ns else "after"
            self.late.append((steady_ns, f"command {sequence}, {off_s:.3f} s {when} its decision"))

    def lack(self, number: int, numbers: bytes) -> None:
        """Count a decided command without a message; `numbers` is its velocity."""
        if self._first is not None and follows(self._first, number):
            self.before_first += 1
            return
        self.missing += 1
        if not self.missing_example:
            self.missing_example = f"command {number} ({shown_command(numbers)})"


def follows(number: int, other: int) -> bool:
    """Return whether `number` comes after `other`; numbers start again after MAX_SEQUENCE."""
    return 0 < (number - other) & MAX_SEQUENCE <= MAX_SEQUENCE // 2


NEAR_NS = 5 * NS_PER_S
"""A command may be another publisher's if one was noticed at most this long before or after it."""


class OtherCommands:
    """Counts the commands without a decision.

    Those sent while another publisher was there are `foreign`, all others are `extra`. All times
    are those of the journal: steady [ns].
    """

    def __init__(self) -> None:
        self.extra = 0
        """The number of messages near which no other publisher was noticed."""

        self.extra_example = ""
        self.foreign = 0
        """The number of messages that another publisher may have sent."""

        self.foreign_example = ""
        self.after_end = 0
        """The number of messages after the journal's end, if the recording continues after it."""

        self._heard_ns: int | None = None
        self._publish = False
        self._waiting: deque[tuple[int, bytes]] = deque()
        """Time and velocities of each message whose publisher may still be noticed."""

    def hear(self, t_ns: int) -> None:
        """Note that another publisher was noticed, and count the waiting messages accordingly."""
        self._heard_ns = t_ns
        while self._waiting:
            at_ns, numbers = self._waiting.popleft()
            if t_ns - at_ns <= NEAR_NS:
                self._note_foreign(numbers)
            else:
                self._note_extra(numbers)

    def publish(self, t_ns: int, others: bool) -> None:
        """Note whether other publishers exist from now on, according to the ROS graph."""
        if others or self._publish:
            self.hear(t_ns)
        self._publish = others

    def doubt(self, t_ns: int, numbers: bytes) -> None:
        """Count an undecided command as foreign if another publisher was noticed, else later."""
        heard = self._publish or (self._heard_ns is not None and t_ns - self._heard_ns <= NEAR_NS)
        if heard:
            self._note_foreign(numbers)
        else:
            self._waiting.append((t_ns, numbers))

    def settle(self, t_ns: int) -> None:
        """Count the messages that have waited longer than NEAR_NS at `t_ns` as extra."""
        while self._waiting and t_ns - self._waiting[0][0] > NEAR_NS:
            self._note_extra(self._waiting.popleft()[1])

    def end(self, end_ns: float) -> None:
        """Count the waiting messages: those before `end_ns` as extra, others as `after_end`."""
        for t_ns, numbers in self._waiting:
            if t_ns < end_ns:
                self._note_extra(numbers)
            else:
                self.after_end += 1
        self._waiting.clear()

    def _note_extra(self, numbers: bytes) -> None:
        self.extra += 1
        self.extra_example = self.extra_example or shown_command(numbers)

    def _note_foreign(self, numbers: bytes) -> None:
        self.foreign += 1
        self.foreign_example = self.foreign_example or shown_command(numbers)


MOST = 64
"""The number of commands that are kept."""


class RecentCommands:
    """The numbers and velocities of the last commands, the oldest first."""

    def __init__(self) -> None:
        self._commands: deque[tuple[int, bytes]] = deque(maxlen=MOST)

    @property
    def were_moving(self) -> bool:
        """Whether the last command was not zero."""
        return bool(self._commands) and not is_zero(self._commands[-1][1])

    def add(self, number: int, numbers: bytes) -> None:
        """Add a command: its sequence number, and its velocities."""
        self._commands.append((number, numbers))

    def withheld(self, count: int) -> list[int]:
        """Return the numbers of the last commands, as many as include `count` that were not 0."""
        held: list[int] = []
        for number, numbers in reversed(self._commands):
            if count <= 0:
                break
            held.append(number)
            count -= not is_zero(numbers)
        return held[::-1]

    def clear(self) -> None:
        """Drop all commands."""
        self._commands.clear()


LAST_ZEROS: Final = 2
"""A daemon that fails while the robot moves may send this many zeros after the last decision."""

ZERO_PERIOD_NS: Final = NS_PER_S // 25
"""A lower bound of the time between two zeros of the watchdog, which sends one every 50 ms."""

STALL_NS: Final = 10 * NS_PER_S
"""A stall that lasts until the end of the recording explains zeros for at most this long."""

JOURNAL_LAG_NS: Final = NS_PER_S
"""How far a journal that a recorder only receives may lag behind the commands."""


class Early(NamedTuple):
    """A message read before its decision; `t_ns` is the steady time of the event read before it."""

    numbers: bytes
    publish_ns: int
    t_ns: int


MAX_WAITING = 20_000
"""The number of commands, decided or sent, that may wait for their counterpart."""

TAIL_NS = 2 * NS_PER_S
"""The message of a decision made at most this long before the journal's end may be under way."""

Decided = tuple[bytes, Moments]
"""The six numbers of a decided command, and when the step that decided it began and ended."""

SEND_FAILED = f"{PublishTwist.__name__} failed"
"""The detail of the fault for a command that could not be sent contains this text."""


class CommandPairs:
    """Compares the decided with the sent commands, from the first snapshot with a proof on."""

    def __init__(self) -> None:
        self.others = OtherCommands()
        self.counts = CommandCounts()
        self.is_counting = False
        self._has_ended = False
        """Whether the last snapshot counts zeros without decision: the daemon must have ended."""

        self._number = 0
        """The number of the last command that was decided in the journal or is in its counts."""

        self._base = 0
        """The number of the last command before counting began; 0 if there was none."""

        self._t_ns = self._log_ns = 0
        """When the last event was handled, on the steady clock and since the epoch."""

        self._wanted: dict[int, Decided] = {}
        self._early: dict[int, list[Early]] = {}
        """Messages before their decision, by number. Two publishers may use one number."""

        self._instead: dict[int, tuple[bytes, int]] = {}
        """Zeros sent in place of decided commands, by number; a stall may still explain them."""

        self._recent = RecentCommands()

    # The wire

    def message(self, sequence: int, data: bytes, publish_ns: int) -> None:
        """Pair a message of the command topic with its decision."""
        if not self.is_counting:
            return
        numbers = numbers_of(data)
        wanted = self._wanted.get(sequence)
        if wanted is None:
            self._keep(sequence, numbers, publish_ns)
        elif wanted[0] == numbers or (numbers == STILL and is_zero(wanted[0])):
            del self._wanted[sequence]
            self.counts.pair(sequence, wanted[1], publish_ns)
        elif numbers == STILL:
            self._instead[sequence] = numbers, publish_ns
        else:
            self.others.doubt(self._t_ns, numbers)

    def _keep(self, sequence: int, numbers: bytes, publish_ns: int) -> None:
        """Keep a message whose decision may follow; count any other as one without a decision."""
        if follows(sequence, self._number):
            self._early.setdefault(sequence, []).append(Early(numbers, publish_ns, self._t_ns))
            if len(self._early) > MAX_WAITING:
                self._doubt_all(self._early.pop(next(iter(self._early))))
        elif self.counts.has_begun or not self._base:
            self.others.doubt(self._t_ns, numbers)  # otherwise decided before the recording began

    def _doubt_all(self, messages: Iterable[Early]) -> None:
        for numbers, _, t_ns in messages:
            self.others.doubt(t_ns, numbers)

    # The journal

    def resume(self, proof: Proof) -> None:
        """Continue from a snapshot, with the number of commands in its proof."""
        differs = proof.commands & MAX_SEQUENCE != self._number
        was_moving = self._recent.were_moving
        more = (proof.commands - self._number) & MAX_SEQUENCE
        if self.is_counting and was_moving and 0 < more <= LAST_ZEROS:
            self._has_ended = True
            while proof.commands & MAX_SEQUENCE != self._number:
                self._decide(STILL, (self._t_ns, 0, 0))
            return
        self.counts.resumed += self.is_counting and differs
        if not self.is_counting or differs:
            self._forget()
            self._number = self._base = proof.commands & MAX_SEQUENCE
            self.is_counting = True

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self.is_counting = False
        self._forget()

    def _forget(self) -> None:
        self._wanted.clear()
        self._early.clear()
        self._instead.clear()
        self._recent.clear()
        self.counts.begin_again()

    def step(self, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Process a step: each command among its effects needs a recorded message."""
        if not self.is_counting:
            return
        self._t_ns, self._log_ns, _ = moments
        if self._has_ended:
            self.counts.resumed += 1
            self._has_ended = False
        if isinstance(event, Tick):
            self._settle()
        elif isinstance(event, LoopStalled):
            self._stall(event, moments)
        elif isinstance(event, ForeignCommandHeard):
            self.others.hear(event.t_ns)
        elif isinstance(event, CommandPublishersSeen):
            self.others.publish(event.t_ns, bool(event.names))
        elif isinstance(event, FaultReported) and SEND_FAILED in event.detail:
            self.counts.unsent = True  # which one is unknown; the next snapshot has the count
            self.stop()
            return
        for effect in effects:
            if isinstance(effect, PublishTwist):
                self._decide(serialized(effect.twist), moments)

    def _decide(self, numbers: bytes, moments: Moments) -> None:
        self._number = number = (self._number + 1) & MAX_SEQUENCE
        self._recent.add(number, numbers)
        early = self._early.pop(number, None)
        if early is None:
            self._wanted[number] = numbers, moments
        else:
            self._decide_late(number, (numbers, moments), early)
        if len(self._wanted) > MAX_WAITING:
            number, (numbers, _) = next(iter(self._wanted.items()))
            del self._wanted[number]
            self.counts.lack(number, numbers)

    def _decide_late(self, number: int, decided: Decided, early: list[Early]) -> None:
        """Pair a decision with one of the messages of its number, which were read before it."""
        numbers, moments = decided
        own = next((each for each in early if each[0] == numbers), None)
        if own is not None:
            self.counts.pair(number, moments, own[1])
        else:
            self._wanted[number] = decided
            own = next((each for each in early if each[0] == STILL), None)
            if own is not None:
                self._instead[number] = own[:2]
        self._doubt_all(each for each in early if each is not own)

    def _stall(self, event: LoopStalled, moments: Moments) -> None:
        """Expect the zeros that the watchdog sent, and zeros in place of the withheld commands."""
        steady_ns, begin_ns, end_ns = moments
        began_ns = max(begin_ns - round(event.stalled_s * NS_PER_S), 1) if begin_ns else 0
        during = steady_ns, began_ns, end_ns
        for number in self._recent.withheld(event.withheld):
            if number in self._wanted:
                self._wanted[number] = STILL, during
            if number in self._instead:
                _, publish_ns = self._instead.pop(number)
                del self._wanted[number]
                self.counts.pair(number, during, publish_ns)
        self._recent.clear()
        for _ in range(min(event.zeros, MAX_WAITING)):
            self._decide(STILL, during)

    def _settle(self) -> None:
        """Count the zeros that no stall explains, and the messages without another publisher."""
        if self._instead:
            for numbers, _ in self._instead.values():
                self.others.doubt(self._t_ns, numbers)
            self._instead.clear()
        self.others.settle(self._t_ns)

    def end(self, cut: int = 0, *, is_own: bool = True) -> tuple[int, int]:
        """Count what still waits; return how many last decisions, old and recent, have no message.

        Old decisions were made more than TAIL_NS before the journal's end. The arguments are those
        of `UndecidedEnd`: with `is_own` False, the recording may continue after the journal's end.
        """
        unexplained = [*self._unexplained(cut, is_own)]
        self.counts.undecided = sum(map(len, self._early.values())) - len(unexplained)
        self._doubt_all(unexplained)
        for number, (_, publish_ns) in self._instead.items():  # the end fell into a stall
            self.counts.pair(number, self._wanted.pop(number)[1], publish_ns)
        old = recent = 0
        for number, (_, moments) in list(self._wanted.items()):
            if self.counts.is_passed(number):
                self.counts.lack(number, self._wanted.pop(number)[0])
            elif self._t_ns - moments[0] > TAIL_NS:
                old += 1
            else:
                recent += 1
        self.others.end(inf if is_own else self._t_ns - JOURNAL_LAG_NS)
        return old, recent

    def _unexplained(self, cut: int, is_own: bool) -> Iterator[Early]:
        """Yield the messages that the end does not explain; it explains at most one per number."""
        for sequence, messages in self._early.items():
            later = (sequence - self._number) & MAX_SEQUENCE
            explained = next(
                (each for each in messages if later <= cut or self._ends_with(each, later, is_own)),
                None,
            )
            yield from (each for each in messages if each is not explained)

    def _ends_with(self, message: Early, later: int, is_own: bool) -> bool:
        """Return whether a message `later` numbers after the last command may follow its end."""
        after_ns = message.publish_ns - self._log_ns
        if not is_own:
            return after_ns > -JOURNAL_LAG_NS
        return message.numbers == STILL and (
            later <= LAST_ZEROS or (later - LAST_ZEROS) * ZERO_PERIOD_NS <= after_ns <= STALL_NS
        )


CUT = 3
"""This many of the last commands in a clip may have been decided after the end of its journal."""


class CommandCheck:
    """Compares commands with decisions by number; in a recording of 0.1.0, only counts commands."""

    def __init__(
        self, report: Report, info: RecordingInfo, journal_topic: str, clock: ClockChanges
    ) -> None:
        self._topic = command_topic(info, journal_topic)
        self._report = report
        self._clock = clock
        self._pairs = CommandPairs()
        self._by_number: bool | None = None
        self._seen = 0

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of the topic, if it is recorded."""
        return {} if self._topic is None else {self._topic: self._message}

    def _message(self, message: Message) -> None:
        """Read a message of the command topic."""
        self._seen += 1
        if self._by_number:
            self._pairs.message(message.sequence, message.data, message.publish_ns)

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Continue from a snapshot."""
        if self._by_number is None:
            self._by_number = snapshot.proof is not None
        if snapshot.proof is not None:
            self._pairs.resume(snapshot.proof)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._pairs.stop()

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare the commands of a step; `moments` is when it began and ended."""
        if self._by_number:
            self._clock.look(event.t_ns, moments[1])
            self._pairs.step(event, effects, moments)

    def end(self, ending_of: EndingOf, moment: JournalEnd) -> None:
        """Report the differences between commands and decisions."""
        self._report.commands = self._seen
        if not self._by_number:
            return
        ending, pairs = ending_of(self._topic), self._pairs
        old, recent = pairs.end(CUT if ending.is_clip else 0, is_own=ending.is_own)
        others = pairs.others
        self._tell_foreign(ending, others.foreign, others.foreign_example)
        self._tell_extra(ending, others.extra, others.extra_example)
        self._tell_missing(ending)
        self._tell_end(ending, old, recent)
        self._tell_undecided(ending)
        if ending.is_own:
            self._tell_late(ending)
        if pairs.counts.unsent:
            self._report.notes.append("the journal tells of commands that could not be sent")
        elif pairs.counts.resumed:
            self._report.miss("a snapshot counts other commands than were decided before it")
        if pairs.counts.out_of_order:
            self._report.miss(
                f"{pairs.counts.out_of_order} commands are not in the order of their number"
            )

    def _tell_foreign(self, ending: Ending, count: int, example: str) -> None:
        if count:
            names = ", ".join(sorted(ending.invariants.foreign))
            text = f"{_without_decision(count, example)}: {names} published as well"
            self._report.notes.append(text)

    def _tell_extra(self, ending: Ending, count: int, example: str) -> None:
        if count:
            ending.accuse(_without_decision(count, example))

    def _tell_missing(self, ending: Ending) -> None:
        pairs = self._pairs
        count = pairs.counts.missing + (0 if ending.is_clip else pairs.counts.before_first)
        if not count:
            return
        text = f"{count} decided commands are missing"
        if pairs.counts.missing_example:
            text += f", the first is {pairs.counts.missing_example}"
        ending.lack(count, text)

    def _tell_end(self, ending: Ending, old: int, recent: int) -> None:
        is_closed = ending.is_whole and ending.ledger is not None and not ending.invariants.foreign
        count = old + (recent if is_closed else 0)
        if count <= ending.lost:
            return
        if not self._pairs.counts.paired and is_closed and old:
            ending.accuse(f"none of {count} decided commands is recorded")
        else:
            self._report.miss(f"the last {count} decided commands are missing")

    def _tell_undecided(self, ending: Ending) -> None:
        notes, undecided = self._report.notes, self._pairs.counts.undecided
        if not ending.is_own:
            if after := undecided + self._pairs.others.after_end:
                notes.append(f"{after} commands are later than the journal that was received")
        elif undecided and not ending.is_clip:
            notes.append(
                f"the last {undecided} zeros have no decision: the recording ends before its "
                "journal tells of a stall or a failure"
            )

    def _tell_late(self, ending: Ending) -> None:
        late = [
            text
            for steady_ns, text in self._pairs.counts.late
            if not self._clock.is_near(steady_ns)
        ]
        if late:
            ending.accuse(f"{len(late)} commands were not sent when decided: {late[0]}")


def _without_decision(count: int, example: str) -> str:
    return f"{count} commands without a decision, such as {example}"
