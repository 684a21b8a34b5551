"""Checks the inputs in a journal against the recorded messages, and says what differs."""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable
from math import nan
from operator import attrgetter
from typing import Any, NamedTuple

from robotctl.kernel.command_types import COMMAND_TYPES, TWIST_STAMPED
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    ScanReceived,
    Twist,
)
from robotctl.messages import cdr
from robotctl.messages.inputs import read_battery_level, read_sectors
from robotctl.messages.motion import (
    Sample,
    decode_twist,
    decode_twist_stamped,
    read_sample,
    sample_of,
)
from robotctl.recording import RecordingInfo
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.recording.format.topics import LATCHED_QOS
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.input_pairs import Input, InputPairs, report_inputs, report_last
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.own_topics import InputTopic, InputTopics, RepeatedLatched
from robotctl.rerun.recording_ends import Ending, JournalEnd


class InputKind(NamedTuple):
    """A kind of input, such as odometry: its name for people and the class of its events.

    Called with such an event, `source` returns its publisher, and `value` what was measured.
    """

    name: str
    event: type[Event]
    source: Callable[[Event], Hashable]
    value: Callable[[Event], Any]


def _sample(event: Event) -> Sample:
    assert isinstance(event, OdomReceived)
    return sample_of(event.odometry)


sequence_of: Callable[[Event], int] = attrgetter("sequence")
_SOURCE, _PUBLISHER = attrgetter("source"), attrgetter("publisher")

ODOMETRY = InputKind("odometry", OdomReceived, _SOURCE, _sample)
BATTERY = InputKind("the battery", BatteryReceived, _PUBLISHER, attrgetter("level"))
SCAN = InputKind("the scan", ScanReceived, _PUBLISHER, attrgetter("sectors"))
WANTED = InputKind("the wanted velocity", GuardedCommandReceived, _PUBLISHER, attrgetter("twist"))


_OFF = Use.OFF.value


class InputCheck:
    """Compares the inputs and messages of one topic, from the first snapshot with a proof on."""

    def __init__(
        self,
        report: Report,
        kind: InputKind,
        topic: InputTopic,
        read: Callable[[bytes], Any],
        info: RecordingInfo,
        *,
        is_always_heard: bool = True,
    ) -> None:
        """`read(data)` returns the value of a message. If `is_always_heard` is False, messages
        become inputs only in some modes of the robot.
        """
        self.topic = topic.name
        self._is_left_out = topic.is_left_out
        self._is_always_heard = is_always_heard
        self._is_latched = any(
            each.name == topic.name and LATCHED_QOS in each.offered_qos for each in info.topics
        )
        self._repeats = RepeatedLatched(info)
        self.is_on = False
        self._report = report
        self.kind = kind
        self._name = kind.name
        self._read = read
        self._pairs = InputPairs()

    def message(self, message: Message) -> None:
        """Pair a message; skip the repeat of a latched message, with which a file may begin."""
        if self._is_latched and self._repeats.observe(message):
            return
        if self.is_on:
            self._pairs.message(message.sequence, self._read(message.data), message.log_ns)

    def received(self, event: Event, seq: int) -> None:
        """Compare an input; `seq` is the number of its entry."""
        if self.is_on:
            kind = self.kind
            found = Input(event.t_ns, kind.source(event), kind.value(event), seq)
            self._pairs.received(sequence_of(event) & MAX_SEQUENCE, found)

    def snapshot(self, has_proof: bool) -> None:
        """Start the comparison at this snapshot if it has a proof."""
        self.is_on = self.is_on or has_proof
        self._repeats.snapshot()
        self._pairs.settle()

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self.is_on = False
        self._pairs.forget()

    def end(self, invariants: Invariants, ending: Ending, moment: JournalEnd) -> None:
        """Report the differences between inputs and messages."""
        pairs, report = self._pairs, self._report
        pairs.end(moment.t_ns, moment.stalled_ns)
        pairs.repeated += self._repeats.excess
        is_left_out = self._is_left_out
        report_inputs(report, invariants, self._name, pairs, ending, is_left_out=is_left_out)
        if not self._is_always_heard:
            return
        last = report_last(report, self._name, pairs, ending, moment, moment.stalled_ns)
        if pairs.unheard + last and pairs.has_one_publisher:
            report.notes.append(
                f"{pairs.unheard + last} messages of {self._name} did not reach the control loop"
            )


def input_checks(report: Report, info: RecordingInfo, journal_topic: str) -> RecordedInputs:
    """Return the checks of the inputs of a recording."""
    topics = InputTopics(info, journal_topic)
    odometry = topics.of("odometry.topic", "odom", cdr.ODOMETRY)
    battery = topics.of("battery.topic", "battery_state", "sensor_msgs/msg/BatteryState")
    scan = InputTopic()
    if info.metadata.get(INFO_RECORD, {}).get("parameter.scan.use", _OFF) != _OFF:
        scan = topics.of("scan.topic", "scan", "sensor_msgs/msg/LaserScan")  # slow
    wanted = topics.of("guard_topic", "cmd_vel_nav", *COMMAND_TYPES)
    is_stamped = wanted.type_name == TWIST_STAMPED
    return RecordedInputs(
        InputCheck(report, ODOMETRY, odometry, read_sample, info),
        InputCheck(report, BATTERY, battery, read_battery_level, info),
        InputCheck(report, SCAN, scan, read_sectors, info),
        InputCheck(
            report,
            WANTED,
            wanted,
            _read_wanted(decode_twist_stamped if is_stamped else decode_twist),
            info,
            is_always_heard=False,
        ),
    )


class RecordedInputs:
    """Runs the check of each kind of input that is compared."""

    def __init__(self, *checks: InputCheck) -> None:
        self._all = checks
        self._by_event = {each.kind.event: each for each in checks}

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each recorded topic."""
        return {each.topic: each.message for each in self._all if each.topic is not None}

    def step(self, event: Event, seq: int) -> None:
        """Compare an event of the journal; `seq` is the number of its entry."""
        check = self._by_event.get(type(event))
        if check is not None:
            check.received(event, seq)

    def snapshot(self, has_proof: bool) -> None:
        """Compare from this snapshot on, if it has a proof."""
        for each in self._all:
            each.snapshot(has_proof)

    def stop(self) -> None:
        """Pause until the next snapshot."""
        for each in self._all:
            each.stop()

    def end(
        self,
        invariants: Invariants,
        ending: Callable[[str | None], Ending],
        moment: JournalEnd,
    ) -> None:
        """Report what differs; `ending(topic)` tells how the recording ends for a topic."""
        for each in self._all:
            each.end(invariants, ending(each.topic), moment)


def _read_wanted(decode: Callable[[bytes], Twist]) -> Callable[[bytes], Twist]:
    """Return a decoder of wanted velocities; it returns NaN for an unreadable message."""

    def read(data: bytes) -> Twist:
        try:
            return decode(data)
        except struct.error:
            return Twist(nan, nan)

    return read
