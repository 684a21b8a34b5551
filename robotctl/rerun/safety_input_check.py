"""Checks the safety inputs in a journal against the recorded messages.

The control loop forwards a value to the kernel if it has changed, and otherwise only from time to
time: of many equal messages, most never become inputs. Some messages may be lost on the way (best
effort), but not all of them over a longer time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from math import isfinite
from typing import Final, NamedTuple

from robotctl.kernel.safety_inputs import REPEATS_PER_TIMEOUT, SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import Event, SafetyInputReceived
from robotctl.kernel.units import NS_PER_S
from robotctl.messages.inputs import MESSAGE_TYPES, reader_of
from robotctl.recording import RecordingInfo
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.recording.format.topics import LATCHED_QOS
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import RecordedStalls
from robotctl.rerun.input_pairs import Input, InputPairs, report_inputs, report_last
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.own_topics import InputTopic, InputTopics, RepeatedLatched
from robotctl.rerun.recording_ends import Ending, JournalEnd

PATIENCE_NS = NS_PER_S // 2
"""It is no fault if no message becomes an input for this long, plus the control loop's stalls."""

GAP_NS = NS_PER_S // 10
"""The time between two messages counts as at most this, since nothing can be missed in a gap."""

BEGIN_NS = 3 * NS_PER_S
"""Like PATIENCE_NS, but at the beginning, when the control loop may not be connected yet."""

MAX_WAITING = 100_000
"""The number of messages, and of inputs, that may wait to be compared; the oldest are dropped."""


class ShownValue(NamedTuple):
    """A message: its number, its value as text (a nan is not equal to itself), and its log time."""

    sequence: int
    value: str
    log_ns: int


class UnheardChange:
    """Finds messages of one publisher that should have become inputs in the journal and did not."""

    def __init__(self, repeat_ns: int) -> None:
        """`repeat_ns`: after this time [ns] an unchanged value becomes an input again."""
        self.example = ""
        """The first messages that should have become inputs and did not, "" if there are none."""

        self._repeat_ns = repeat_ns
        self._waiting: deque[ShownValue] = deque(maxlen=MAX_WAITING)
        self._heard: set[int] = set()
        self._last: ShownValue | None = None
        """The last message that became an input; before there is one, the first of all messages."""

        self._is_begin = True
        self._since: ShownValue | None = None
        self._before_ns = self._unheard_ns = 0

    def message(self, shown: ShownValue) -> None:
        """Store a message, whose input may follow."""
        self._waiting.append(shown)

    def heard(self, sequence: int) -> None:
        """Note that the message with this number became an input in the journal."""
        self._heard.add(sequence)

    def forget(self) -> None:
        """Start over, because journal entries are missing."""
        self._waiting.clear()
        self._heard.clear()
        self._last = self._since = None
        self._is_begin = True

    def settle(self, stall_ns: int) -> None:
        """Judge the messages up to the last input; a stall of `stall_ns` may have delayed some."""
        newest = max(self._heard, default=0)
        while self._waiting and self._waiting[0].sequence <= newest:
            self._take(self._waiting.popleft(), stall_ns)
        if len(self._heard) > MAX_WAITING:
            self._heard.clear()

    def end(self, log_ns: int, stall_ns: int) -> None:
        """Judge the messages up to the end of the journal."""
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
            patience_ns = stall_ns + (BEGIN_NS if self._is_begin else PATIENCE_NS)
            if self._unheard_ns > patience_ns and not self.example:
                self.example = f"messages {self._since.sequence} to {shown.sequence}"
        self._before_ns = shown.log_ns


NAMES: Final = {
    SafetyInput.ESTOP: "the emergency stop button",
    SafetyInput.JOY: "the gamepad",
    SafetyInput.BUMPER: "the bumper",
    SafetyInput.TILT: "the tilt",
    SafetyInput.DIAGNOSTICS: "the diagnostics",
}


class SafetyInputCheck:
    """Compares one safety input with its messages, from the first snapshot with a proof on."""

    def __init__(
        self, report: Report, info: RecordingInfo, kind: SafetyInput, topic: InputTopic
    ) -> None:
        values = info.metadata.get(INFO_RECORD, {})
        robot = values.get("robot", "")
        button = int(_number(values, "parameter.inputs.joy.button", 0.0))
        default_s = SafetyInputParams().of(kind).timeout_s
        timeout_s = _number(values, f"parameter.inputs.{kind.value}.timeout_s", default_s)
        self.topic = topic.name
        self._is_left_out = topic.is_left_out
        self._is_latched = any(
            each.name == topic.name and LATCHED_QOS in each.offered_qos for each in info.topics
        )
        self._report = report
        self._name = NAMES[kind]
        self._read = reader_of(kind, button=button, robot=robot)
        self._is_diagnosis = kind is SafetyInput.DIAGNOSTICS
        """The journal has only the worst diagnosis of all names: its value is not compared."""

        self._pairs = InputPairs()
        self._repeat_ns = round(timeout_s * NS_PER_S / REPEATS_PER_TIMEOUT)
        self._unheard = UnheardChange(self._repeat_ns)
        self._is_on = False
        self._repeats = RepeatedLatched(info)

    def message(self, message: Message) -> None:
        """Read a message; skip a repeat of a latched message, as at the begin of a file."""
        is_repeat = self._is_latched and self._repeats.observe(message)
        if is_repeat or not self._is_on:
            return
        if self._is_diagnosis:
            self._pairs.message(message.sequence, None, message.log_ns)
            return
        value, _ = self._read(message.data)
        self._pairs.message(message.sequence, value, message.log_ns)
        self._unheard.message(ShownValue(message.sequence, str(value), message.log_ns))

    def received(self, event: SafetyInputReceived, seq: int) -> None:
        """Compare an input; `seq` is the number of its entry."""
        if not self._is_on:
            return
        sequence = event.sequence & MAX_SEQUENCE
        value = None if self._is_diagnosis else event.value
        self._pairs.received(sequence, Input(event.t_ns, event.publisher, value, seq))
        if not self._is_diagnosis:
            self._unheard.heard(sequence)

    def snapshot(self, has_proof: bool, stall_ns: int) -> None:
        """Start the comparison at this snapshot if it has a proof."""
        self._is_on = self._is_on or has_proof
        self._repeats.snapshot()
        self._pairs.settle()
        self._unheard.settle(stall_ns)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._is_on = False
        self._pairs.forget()
        self._unheard.forget()

    def end(
        self, invariants: Invariants, ending: Ending, moment: JournalEnd, longest_ns: int
    ) -> None:
        """Report what differs; the longest stall was `longest_ns`."""
        pairs, report = self._pairs, self._report
        if self._is_diagnosis:
            if ending.is_clip:
                return  # its messages begin later than its journal
            pairs.repeated = 0  # robotctl publishes on the topic as well
        else:
            pairs.repeated += self._repeats.excess
        pairs.end(moment.t_ns, moment.stalled_ns)
        is_left_out = self._is_left_out
        report_inputs(report, invariants, self._name, pairs, ending, is_left_out=is_left_out)
        self._unheard.end(moment.log_ns, longest_ns)
        if self._unheard.example and pairs.has_one_publisher:
            report.miss(f"the journal does not hold {self._unheard.example} of {self._name}")
        if not self._is_diagnosis:
            waited_ns = longest_ns + self._repeat_ns
            report_last(report, self._name, pairs, ending, moment, waited_ns, is_rare=True)


class SafetyInputChecks:
    """Runs the checks of all safety inputs that the configuration uses."""

    def __init__(
        self, report: Report, info: RecordingInfo, journal_topic: str, stalls: RecordedStalls
    ) -> None:
        """Read the configuration from the metadata; `stalls` are those of the journal."""
        self._stalls = stalls
        topics = InputTopics(info, journal_topic)
        self._checks = {
            kind: SafetyInputCheck(report, info, kind, _topic(topics, kind))
            for kind in SafetyInput
            if _is_used(info, kind)
        }

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each recorded topic; inputs may share one."""
        topics = {each.topic for each in self._checks.values() if each.topic is not None}
        return {topic: partial(self._message, topic) for topic in topics}

    def _message(self, topic: str, message: Message) -> None:
        for each in self._checks.values():
            if each.topic == topic:
                each.message(message)

    def step(self, event: Event, seq: int) -> None:
        """Compare an event of the journal; `seq` is the number of its entry."""
        if isinstance(event, SafetyInputReceived):
            check = self._checks.get(event.kind)
            if check is not None and event.sequence:  # 0: before it was told
                check.received(event, seq)

    def snapshot(self, has_proof: bool) -> None:
        """Compare from this snapshot on, if it has a proof."""
        for each in self._checks.values():
            each.snapshot(has_proof, self._stalls.longest_ns)

    def stop(self) -> None:
        """Pause until the next snapshot."""
        for each in self._checks.values():
            each.stop()

    def end(
        self,
        invariants: Invariants,
        ending: Callable[[str | None], Ending],
        moment: JournalEnd,
    ) -> None:
        """Report what differs; `ending(topic)` tells how the recording ends for a topic."""
        for each in self._checks.values():
            each.end(invariants, ending(each.topic), moment, self._stalls.longest_ns)


def _number(values: Mapping[str, str], key: str, default: float) -> float:
    """Return a parameter from the metadata, or `default` if it is not a number."""
    with suppress(KeyError, ValueError):
        value = float(values[key])
        return value if isfinite(value) else default
    return default


def _is_used(info: RecordingInfo, kind: SafetyInput) -> bool:
    values = info.metadata.get(INFO_RECORD, {})
    return values.get(f"parameter.inputs.{kind.value}.use", Use.OFF.value) != Use.OFF.value


def _topic(topics: InputTopics, kind: SafetyInput) -> InputTopic:
    default = SafetyInputParams().of(kind).topic
    return topics.of(f"inputs.{kind.value}.topic", default, MESSAGE_TYPES[kind])
