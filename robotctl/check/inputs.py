"""Compare the inputs in the journal with their recorded messages.

The control loop may lose messages (best effort), but not all during half a second. A changed value
of a safety input is an input at once, an unchanged value from time to time. A wanted velocity is an
input only in the mode MOVING.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Hashable
from functools import partial
from math import inf, nan
from typing import Any, Final, NamedTuple

from robotctl.check.ends import Ending, EndingOf, JournalEnd
from robotctl.check.journal import Moments
from robotctl.check.report import TOLERANCE, Report
from robotctl.check.times import RecordedStalls
from robotctl.check.topics import (
    InputTopic,
    RepeatedLatched,
    RobotTopics,
    Slot,
    Waiting,
    number_in,
)
from robotctl.kernel.codec import Snapshot
from robotctl.kernel.constants import COMMAND_TYPES, NS_PER_S, TWIST_STAMPED
from robotctl.kernel.safety_inputs import REPEATS_PER_TIMEOUT, SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import (
    BatteryReceived,
    Effect,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    SafetyInputReceived,
    ScanReceived,
    Twist,
)
from robotctl.messages import cdr
from robotctl.messages.inputs import (
    MESSAGE_TYPES,
    Sample,
    decode_twist,
    decode_twist_stamped,
    read_battery_level,
    read_sample,
    read_sectors,
    reader_of,
    sample_of,
)
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.recording.read.messages import Message

UNHEARD_NS = NS_PER_S // 2
"""Messages may be lost for this time, in addition to a stall of the control loop."""

GAP_NS = NS_PER_S // 10
"""Between two messages, at most this time counts towards UNHEARD_NS."""

BEGIN_NS = 3 * NS_PER_S
"""Messages may be lost for this time at the begin."""

MAX_WAITING = 100_000
"""The maximum number of messages, and of inputs, that wait; the oldest are dropped."""


class ShownValue(NamedTuple):
    """The number of a message, its value as text and its log time."""

    sequence: int
    value: str
    log_ns: int


class UnheardChange:
    """Finds changes in one publisher's messages that the journal lacks as inputs."""

    def __init__(self, repeat_ns: int) -> None:
        """`repeat_ns` is the time [ns] after which an unchanged value is an input again."""
        self.example = ""
        """The first messages that should have been inputs, or ""."""

        self._repeat_ns = repeat_ns
        self._waiting: deque[ShownValue] = deque(maxlen=MAX_WAITING)
        self._heard: set[int] = set()
        self._last: ShownValue | None = None
        """The last message that was an input, or else the first of all messages."""

        self._is_begin = True
        self._since: ShownValue | None = None
        self._before_ns = self._unheard_ns = 0

    def message(self, shown: ShownValue) -> None:
        """Add a recorded message of the publisher, to be checked later."""
        self._waiting.append(shown)

    def heard(self, sequence: int) -> None:
        """Add the number of a message that is an input in the journal."""
        self._heard.add(sequence)

    def forget(self) -> None:
        """Start over, after a gap in the journal."""
        self._waiting.clear()
        self._heard.clear()
        self._last = self._since = None
        self._is_begin = True

    def settle(self, stall_ns: int) -> None:
        """Check messages up to the newest input. A gap may last UNHEARD_NS + `stall_ns`."""
        newest = max(self._heard, default=0)
        while self._waiting and self._waiting[0].sequence <= newest:
            self._take(self._waiting.popleft(), stall_ns)
        if len(self._heard) > MAX_WAITING:
            self._heard.clear()

    def end(self, log_ns: int, stall_ns: int) -> None:
        """Check messages until the end `log_ns`. A gap may last UNHEARD_NS + `stall_ns`."""
        self.settle(stall_ns)
        for shown in self._waiting:
            if shown.log_ns <= log_ns:
                self._take(shown, stall_ns)

    def _take(self, shown: ShownValue, stall_ns: int) -> None:
        if shown.sequence in self._heard:
            self._heard.discard(shown.sequence)
            self._last, self._since, self._is_begin = shown, None, False
            return
        last = self._last = self._last or shown
        if shown.value == last.value and shown.log_ns - last.log_ns < self._repeat_ns:
            self._since = None
        elif self._since is None:
            self._since, self._unheard_ns = shown, 0
        else:
            self._unheard_ns += min(shown.log_ns - self._before_ns, GAP_NS)
            patience_ns = stall_ns + (BEGIN_NS if self._is_begin else UNHEARD_NS)
            if self._unheard_ns > patience_ns and not self.example:
                self.example = f"messages {self._since.sequence} to {shown.sequence}"
        self._before_ns = shown.log_ns


EDGE_NS: Final = NS_PER_S // 2
"""Inputs this close to the end of a journal may lack their message."""

UNFOUND_NS: Final = 2 * NS_PER_S
"""The longest time until the recorder discovers a publisher."""

AFTER_NS: Final = 2 * NS_PER_S
"""The longest time from the last journal entry to a recorded message."""

FEW: Final = 10
"""The limit on messages under way at the end, at a rate of zero."""

BURST: Final = 10.0
"""The factor of the mean rate in the limit on messages under way."""

LOST: Final = 2
"""This many more messages may be lost after the last input than before."""


class Input(NamedTuple):
    """An input in the journal: steady time, publisher, value, and number of the entry."""

    t_ns: int
    source: Hashable
    value: Any
    seq: int


class Heard(NamedTuple):
    """A message: its value, and its log time [ns since the epoch]."""

    value: Any
    log_ns: int


class InputPairs:
    """Compares the inputs of one topic with its messages, by number and value."""

    def __init__(self) -> None:
        self.tolerance = 0.0
        """Tolerance for the angle of odometry [rad]."""

        self.paired = 0
        self.lacking = 0
        """Inputs without a message, except `before_first` and those near the end."""

        self.lacking_example = ""
        self.before_first = 0
        """Inputs without a message, before the first of their publisher with one."""

        self.before_found = 0
        """The part of `before_first` within UNFOUND_NS of the publisher's first input."""

        self.at_begin = 0
        """Inputs without a message in the first EDGE_NS, before any input with a message."""

        self.differing = 0
        """Inputs whose message has another value."""

        self.differing_example = ""
        self.unheard = 0
        """Messages without an input, between messages with one."""

        self.repeated = 0
        """Messages whose number is not above the previous one, except those of other publishers."""

        self.later_ns: list[int] = []
        """The log times of the messages with higher numbers than all paired ones."""

        self._waiting: Waiting[Input, Heard] = Waiting(self._judge)
        self._found: dict[Hashable, int] = {}
        """The number of the last pair, by publisher."""

        self._begun: dict[Hashable, int] = {}
        """Steady time [ns] of the first paired input, by publisher."""

        self._lives: dict[Hashable, tuple[int, int]] = {}
        """Steady times [ns] of the first and the last input of each publisher."""

        self._unfound: list[tuple[int, Input]] = []
        """Inputs without a message, of publishers without a pair."""

        self._unheard: list[tuple[int, int]] = []
        """Number and log time of each message without an input."""

        self._paired: tuple[int, int] | None = None
        """The lowest and the highest paired number."""

        self._first_ns = self._last_ns = self._newest = self._sent_ns = 0
        self._has_others = False
        """Whether another publisher sent a message later, with a lower number."""

    @property
    def has_one_publisher(self) -> bool:
        """Whether one publisher sent all inputs and messages."""
        return len(self._lives) <= 1 and not self._has_others

    @property
    def rate_hz(self) -> float:
        """The mean rate of messages from the first to the last paired one; inf if unknown."""
        if self._paired is None or self._last_ns <= self._first_ns:
            return inf
        first, last = self._paired
        return (last - first) * NS_PER_S / (self._last_ns - self._first_ns)

    def message(self, message: Message, value: Any) -> None:
        """Add a message of the topic; `value` is what its input in the journal should have."""
        number = message.sequence
        if number <= self._newest and message.publish_ns > self._sent_ns:
            self._has_others = True
        elif number <= self._newest:
            self.repeated += 1
        self._newest, self._sent_ns = number, message.publish_ns
        slot = self._waiting.slot(number)
        slot.sent.append(Heard(value, message.log_ns))
        self._pair(number, slot)

    def received(self, number: int, found: Input) -> None:
        """Add an input of the journal; `number` is its message's sequence number, 0 for none."""
        if number:
            begin_ns, _ = self._lives.get(found.source, (found.t_ns, 0))
            self._lives[found.source] = begin_ns, found.t_ns
            slot = self._waiting.slot(number)
            slot.entries.append(found)
            self._pair(number, slot)

    def forget(self) -> None:
        """Drop inputs and messages without a counterpart, after a gap in the journal."""
        self._waiting.clear()

    def end(self, t_ns: int, stalled_ns: int) -> None:
        """Count unpaired inputs and messages at the end `t_ns`, after stalls of `stalled_ns`."""
        left = [*self._waiting.rest()]
        newest = max((number for number, slot in left if slot.sent), default=0)
        newest = newest if self.has_one_publisher else 0
        for number, slot in left:
            if not slot.sent:
                slot.entries = [
                    each
                    for each in slot.entries
                    if number <= max(newest, self._found.get(each.source, 0))
                    or t_ns - each.t_ns > EDGE_NS + stalled_ns
                ]
            self._judge(number, slot)
        for number, each in self._unfound:
            begin_ns, end_ns = self._lives[each.source]
            if each.source in self._found or end_ns - begin_ns > UNFOUND_NS:
                self._lack(number, each)
        first, last = self._paired or (0, 0)
        self.unheard += sum(first < number < last for number, _ in self._unheard)
        self.later_ns = [log_ns for number, log_ns in self._unheard if number > last]

    def _pair(self, number: int, slot: Slot[Input, Heard]) -> None:
        """Remove the inputs and messages of a number that have the same value."""
        for found in list(slot.entries):
            for sent in slot.sent:
                if _same(found.value, sent.value, self.tolerance):
                    slot.entries.remove(found)
                    slot.sent.remove(sent)
                    self._note(number, found)
                    break
        if not slot.entries and not slot.sent:
            self._waiting.drop(number)

    def _note(self, number: int, found: Input) -> None:
        self.paired += 1
        self._found[found.source] = number
        self._begun.setdefault(found.source, found.t_ns)
        if self._paired is None:
            self._first_ns = self._last_ns = found.t_ns
            self._paired = number, number
        elif number > self._paired[1]:
            self._paired = self._paired[0], number
            self._last_ns = found.t_ns

    def _judge(self, number: int, slot: Slot[Input, Heard]) -> None:
        """Count inputs and messages of one number without a counterpart of the same value."""
        for found in slot.entries:
            if slot.sent and self.has_one_publisher:  # it was received, with another value
                self.differing += 1
                self.differing_example = self.differing_example or (
                    f"entry {found.seq} has {found.value}, "
                    f"message {number} has {slot.sent.pop().value}"
                )
            elif found.source in self._found:
                self._lack(number, found)
            else:
                self._unfound.append((number, found))
        self._unheard += [(number, each.log_ns) for each in slot.sent]

    def _lack(self, number: int, found: Input) -> None:
        is_before = found.t_ns < self._begun.get(found.source, 0)
        if is_before or self._paired is None:
            earliest_ns = min(begin_ns for begin_ns, _ in self._lives.values())
            self.at_begin += found.t_ns - earliest_ns <= EDGE_NS
        if is_before:
            begin_ns, _ = self._lives[found.source]
            self.before_first += 1
            self.before_found += found.t_ns - begin_ns <= UNFOUND_NS
            return
        self.lacking += 1
        self.lacking_example = self.lacking_example or f"entry {found.seq}, message {number}"


def _same(one: Any, other: Any, tolerance: float) -> bool:
    if one == other or repr(one) == repr(other):  # nan differs from itself
        return True
    if not tolerance or not isinstance(one, Sample) or not isinstance(other, Sample):
        return False
    return one._replace(theta=other.theta) == other and abs(one.theta - other.theta) <= tolerance


class InputCheck:
    """Compares inputs and messages of a topic once a snapshot has a `Proof` (count and CRC)."""

    def __init__(
        self,
        report: Report,
        topics: RobotTopics,
        name: str,
        topic: InputTopic,
        read: Callable[[bytes], Any],
        *,
        is_always_heard: bool = True,
        repeat_ns: int = 0,
    ) -> None:
        """`read(data)` returns the value of a message.

        Unless `is_always_heard`, some messages are never inputs. With a `repeat_ns` [ns], a changed
        value is an input at once, and an unchanged value after this time.
        """
        self.topic = topic.name
        self._name = name
        self._is_left_out = topic.is_left_out
        self._is_latched = topics.is_latched(topic.name)
        self._repeats = RepeatedLatched(topics.info)
        self._report = report
        self._read = read
        self._is_always_heard = is_always_heard
        self._repeat_ns = repeat_ns
        self._pairs = InputPairs()
        self._unheard = UnheardChange(repeat_ns) if repeat_ns else None
        self._is_on = False

    def message(self, message: Message) -> None:
        """Compare a message, unless it repeats a latched message."""
        if not self._is_on or (self._is_latched and self._repeats.observe(message)):
            return
        value = self._read(message.data)
        self._pairs.message(message, value)
        if self._unheard is not None:
            self._unheard.message(ShownValue(message.sequence, str(value), message.log_ns))

    def received(self, event: _Input, value: Any, seq: int) -> None:
        """Add an input of the journal, which is entry number `seq`."""
        if self._is_on:
            number = event.sequence & MAX_SEQUENCE
            publisher = event.source if isinstance(event, OdomReceived) else event.publisher
            self._pairs.received(number, Input(event.t_ns, publisher, value, seq))
            if self._unheard is not None:
                self._unheard.heard(number)

    def snapshot(self, has_proof: bool, stall_ns: int) -> None:
        """Begin the comparison if the snapshot has a `Proof` (command count and CRC).

        `stall_ns` is the longest stall of the control loop so far.
        """
        self._is_on = self._is_on or has_proof
        self._pairs.tolerance = 0.0 if self._report.bitwise else TOLERANCE
        self._repeats.snapshot()
        if self._unheard is not None:
            self._unheard.settle(stall_ns)

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        self._is_on = False
        self._pairs.forget()
        if self._unheard is not None:
            self._unheard.forget()

    def end(self, ending: Ending, moment: JournalEnd, stall_ns: int) -> None:
        """Report the differences between inputs and messages; `stall_ns` is the longest stall."""
        pairs, report, unheard = self._pairs, self._report, self._unheard
        pairs.end(moment.t_ns, moment.stalled_ns)
        # In a latched topic, a new file repeats a message that may come before its original.
        pairs.repeated = self._repeats.excess + (0 if self._is_latched else pairs.repeated)
        self._tell_differing(ending)
        self._tell_lacking(ending)
        if pairs.repeated and pairs.has_one_publisher:
            report.miss(f"{pairs.repeated} messages of {self._name} are repeated or out of order")
        if unheard is not None:
            unheard.end(moment.log_ns, stall_ns)
            if unheard.example and pairs.has_one_publisher:
                report.miss(f"the journal does not hold {unheard.example} of {self._name}")
            self._lost_at_end(ending, moment, stall_ns + self._repeat_ns, inf)
        elif self._is_always_heard:
            most = pairs.unheard + LOST
            lost = pairs.unheard + self._lost_at_end(ending, moment, moment.stalled_ns, most)
            if lost and pairs.has_one_publisher:
                report.notes.append(
                    f"{lost} messages of {self._name} did not reach the control loop"
                )

    def _tell_differing(self, ending: Ending) -> None:
        pairs = self._pairs
        if pairs.differing and pairs.has_one_publisher:
            text = f"{pairs.differing} messages are not what the control loop received as"
            ending.accuse(f"{text} {self._name}: {pairs.differing_example}")

    def _tell_lacking(self, ending: Ending) -> None:
        pairs, report = self._pairs, self._report
        count = pairs.lacking + (0 if ending.is_clip else pairs.before_first)
        if not (ending.is_clip or ending.has_begin) and pairs.at_begin:
            count -= pairs.at_begin
            report.notes.append(
                f"the first {pairs.at_begin} messages of {self._name} are not here: the file "
                "before has them"
            )
        elif ending.ledger is None and not ending.is_clip and pairs.before_found:
            count -= pairs.before_found
            report.notes.append(
                f"the first {pairs.before_found} messages of {self._name} are not recorded: the "
                "recorder finds a publisher later than the control loop"
            )
        if not count:
            return
        text = f"{count} messages of {self._name} that the control loop received are not recorded"
        if pairs.lacking_example:
            text += f", the first is of {pairs.lacking_example}"
        # A robot that was observed may give the topic another name.
        if count > ending.lost and (self._is_left_out or (not self.topic and not ending.is_own)):
            report.notes.append(f"the topic of {self._name} was not recorded, as configured")
        else:
            ending.lack(count, text)

    def _lost_at_end(self, ending: Ending, moment: JournalEnd, waited_ns: int, most: float) -> int:
        """Return the number of messages after the last input that were lost.

        Messages of the last EDGE_NS + `waited_ns` may be under way. Return 0 if nothing is known,
        or after a report of too many messages; `most` is the limit on lost ones.
        """
        pairs = self._pairs
        if not (pairs.paired and pairs.has_one_publisher and ending.is_own) or moment.clock_changed:
            return 0
        window_ns = EDGE_NS + waited_ns
        later = pairs.later_ns
        earlier = sum(each < moment.log_ns - window_ns for each in later)
        under_way = FEW + BURST * pairs.rate_hz * window_ns / NS_PER_S
        if after := sum(each > moment.log_ns + AFTER_NS for each in later):
            wrong = f"{after} messages are recorded after the end of the journal"
        elif len(later) - earlier > under_way or earlier > most:
            wrong = f"the last {len(later)} messages never became an input"
        else:
            return earlier
        self._report.miss(f"{self._name}: {wrong}")
        return 0


_Input = (
    OdomReceived | BatteryReceived | ScanReceived | GuardedCommandReceived | SafetyInputReceived
)


def _value(event: _Input) -> Any:
    """Return the value of an input, None for diagnostics."""
    match event:
        case OdomReceived():
            return sample_of(event.odometry)
        case BatteryReceived():
            return event.level
        case ScanReceived():
            return event.sectors
        case GuardedCommandReceived():
            return event.twist
        case SafetyInputReceived():
            return None if event.kind is SafetyInput.DIAGNOSTICS else event.value


NAMES: Final = {
    SafetyInput.ESTOP: "the emergency stop button",
    SafetyInput.JOY: "the gamepad",
    SafetyInput.BUMPER: "the bumper",
    SafetyInput.TILT: "the tilt",
    SafetyInput.DIAGNOSTICS: "the diagnostics",
}


class InputChecks:
    """Compares the journal's inputs with the recorded messages, for each input in use."""

    def __init__(self, report: Report, topics: RobotTopics, stalls: RecordedStalls) -> None:
        """`stalls` has the stalls of the control loop in the journal."""
        self._report, self._topics, self._stalls = report, topics, stalls
        odometry = topics.recorded("odometry.topic", "odom", cdr.ODOMETRY)
        battery = topics.recorded("battery.topic", "battery_state", "sensor_msgs/msg/BatteryState")
        scan = InputTopic()
        if self._topics.values.get("parameter.scan.use", Use.OFF.value) != Use.OFF.value:
            scan = topics.recorded("scan.topic", "scan", "sensor_msgs/msg/LaserScan")  # slow
        wanted = InputTopic()
        if self._topics.values.get("parameter.guard") == str(True):
            wanted = topics.recorded("guard_topic", "cmd_vel_nav", *COMMAND_TYPES)
        decode = decode_twist_stamped if wanted.type_name == TWIST_STAMPED else decode_twist
        self._checks: dict[object, InputCheck] = {
            OdomReceived: InputCheck(report, topics, "odometry", odometry, read_sample),
            BatteryReceived: InputCheck(report, topics, "the battery", battery, read_battery_level),
            ScanReceived: InputCheck(report, topics, "the scan", scan, read_sectors),
            GuardedCommandReceived: InputCheck(
                report,
                topics,
                "the wanted velocity",
                wanted,
                partial(_read_wanted, decode),
                is_always_heard=False,
            ),
        }
        self._checks |= {kind: self._safety_input(kind) for kind in SafetyInput if self._uses(kind)}

    def _uses(self, kind: SafetyInput) -> bool:
        use = self._topics.values.get(f"parameter.inputs.{kind.value}.use", Use.OFF.value)
        return use != Use.OFF.value

    def _safety_input(self, kind: SafetyInput) -> InputCheck:
        params, values = SafetyInputParams().of(kind), self._topics.values
        key = f"inputs.{kind.value}"
        topic = self._topics.recorded(f"{key}.topic", params.topic, MESSAGE_TYPES[kind])
        about = self._report, self._topics, NAMES[kind], topic
        if kind is SafetyInput.DIAGNOSTICS:
            return _DiagnosticsCheck(*about, lambda _: None, is_always_heard=False)
        timeout_s = number_in(values, f"parameter.{key}.timeout_s", params.timeout_s)
        button = int(number_in(values, "parameter.inputs.joy.button", 0.0))
        read = reader_of(kind, button=button, robot=values.get("robot", ""))
        return InputCheck(
            *about,
            lambda data: read(data)[0],
            is_always_heard=False,
            repeat_ns=round(timeout_s * NS_PER_S / REPEATS_PER_TIMEOUT),
        )

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each recorded topic, by name."""
        topics = {each.topic for each in self._checks.values() if each.topic is not None}
        return {topic: partial(self._message, topic) for topic in topics}

    def _message(self, topic: str, message: Message) -> None:
        for each in self._checks.values():
            if each.topic == topic:
                each.message(message)

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare the journal entry `seq` with recorded messages if its event is an input."""
        if not isinstance(event, _Input) or moments[1] < self._topics.clip_begin_ns:
            return
        key: object = event.kind if isinstance(event, SafetyInputReceived) else type(event)
        check = self._checks.get(key)
        if check is not None:
            check.received(event, _value(event), seq)

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Begin the comparison if the snapshot has a `Proof` (command count and CRC)."""
        for each in self._checks.values():
            each.snapshot(snapshot.proof is not None, self._stalls.longest_ns)

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        for each in self._checks.values():
            each.stop()

    def end(self, ending: EndingOf, moment: JournalEnd) -> None:
        """Report the differences; call this at the end of the journal."""
        for each in self._checks.values():
            each.end(ending(each.topic), moment, self._stalls.longest_ns)


class _DiagnosticsCheck(InputCheck):
    """Compares diagnostics by message number alone."""

    def end(self, ending: Ending, moment: JournalEnd, stall_ns: int) -> None:
        if not ending.is_clip:  # its messages begin later than its journal
            self._pairs.repeated = -self._repeats.excess
            super().end(ending, moment, stall_ns)


def _read_wanted(decode: Callable[[bytes], Twist], data: bytes) -> Twist:
    """Return a wanted velocity, NaN for an unreadable message."""
    try:
        return decode(data)
    except struct.error:
        return Twist(nan, nan)
