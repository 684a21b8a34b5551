"""Checks the inputs in a journal against the recorded messages, and says what differs."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from math import nan
from typing import Any

from robotctl.cdr.battery import read_battery_level
from robotctl.cdr.motion import decode_twist, decode_twist_stamped, read_sample, sample_of
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.types import (
    COMMAND_TYPES,
    TWIST_STAMPED,
    BatteryReceived,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    ScanReceived,
    Twist,
)
from robotctl.recording import RecordingInfo
from robotctl.recording.format.metadata_names import INFO_RECORD
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.recording.format.topics import LATCHED_QOS
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.ending import Ending
from robotctl.rerun.input_pairs import Input, InputPairs
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.own_topics import full_name

_NOTHING = "[]"
"""An empty list of topics in the metadata."""


class InputCheck:
    """The comparison of the inputs of one topic, from the first snapshot with a proof on."""

    def __init__(
        self,
        report: Report,
        name: str,
        topic: str | None,
        read: Callable[[bytes], Any],
        info: RecordingInfo,
        *,
        is_always_heard: bool = True,
    ) -> None:
        """`name` is that of the input, `topic` its topic, None if it is not recorded.

        `read(data)` returns the value of a message. What is not always heard becomes an input in
        some modes only.
        """
        self.topic = topic
        self._is_always_heard = is_always_heard
        self._is_latched = any(
            each.name == topic and LATCHED_QOS in each.offered_qos for each in info.topics
        )
        self._last: tuple[int, bytes] | None = None
        self.is_on = False
        self._report = report
        self._name = name
        self._read = read
        self._pairs = InputPairs()

    def message(self, message: Message) -> None:
        """Take a message; a file begins with the last latched one of the file before."""
        if self._is_latched:
            last, self._last = self._last, (message.sequence, message.data)
            if self._last == last:
                return
        if self.is_on:
            self._pairs.message(message.sequence, self._read(message.data))

    def received(
        self,
        event: OdomReceived | BatteryReceived | ScanReceived | GuardedCommandReceived,
        seq: int,
    ) -> None:
        """Take an input; `seq` is the number of its entry."""
        if not self.is_on:
            return
        sequence = event.sequence & MAX_SEQUENCE
        if isinstance(event, OdomReceived):
            found = Input(event.t_ns, event.source, sample_of(event.odometry), seq)
        elif isinstance(event, BatteryReceived):
            found = Input(event.t_ns, event.publisher, event.level, seq)
        elif isinstance(event, ScanReceived):
            found = Input(event.t_ns, event.publisher, event.sectors, seq)
        else:
            found = Input(event.t_ns, event.publisher, event.twist, seq)
        self._pairs.received(sequence, found)

    def snapshot(self, has_proof: bool) -> None:
        """Compare from this snapshot on, if it is one of this version."""
        self.is_on = self.is_on or has_proof
        self._pairs.settle()

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self.is_on = False
        self._pairs.forget()

    def end(self, invariants: Invariants, ending: Ending, end_ns: int) -> None:
        """Report what differs."""
        pairs, report = self._pairs, self._report
        pairs.end(end_ns)
        if pairs.differing:
            text = f"{pairs.differing} messages are not what the control loop received as"
            text = f"{text} {self._name}: {pairs.differing_example}"
            if pairs.has_one_publisher or pairs.differing > ending.lost:
                ending.accuse(report, invariants, text)
            else:
                report.notes.append(text)
        self._tell_lacking(invariants, ending)
        if pairs.repeated and pairs.has_one_publisher:
            report.miss(f"{pairs.repeated} messages of {self._name} are repeated or out of order")
        if pairs.unheard and pairs.has_one_publisher and self._is_always_heard:
            report.notes.append(
                f"{pairs.unheard} messages of {self._name} did not reach the control loop"
            )

    def _tell_lacking(self, invariants: Invariants, ending: Ending) -> None:
        pairs, report = self._pairs, self._report
        count = pairs.lacking + (0 if ending.is_clip else pairs.before_first)
        if ending.ledger is None and not ending.is_clip and pairs.before_found:
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
        if count <= ending.lost:
            report.notes.append(f"{text}: {ending.lost} were counted as lost")
        elif ending.is_filtered and self.topic is None:
            report.notes.append(f"the topic of {self._name} was not recorded, as configured")
        elif ending.ledger is None:
            report.miss(f"{text}; {ending.unknown_losses}")
        else:
            ending.accuse(report, invariants, text)


def input_checks(report: Report, info: RecordingInfo, journal_topic: str) -> Inputs:
    """Return the checks of the inputs of a recording."""
    return Inputs(
        InputCheck(
            report, "odometry", _topic(info, journal_topic, "odometry", "odom"), read_sample, info
        ),
        InputCheck(
            report,
            "the battery",
            _topic(info, journal_topic, "battery", "battery_state"),
            read_battery_level,
            info,
        ),
        InputCheck(report, "the scan", _scan_topic(info, journal_topic), _read_sectors, info),
        InputCheck(
            report,
            "the wanted velocity",
            _guard_topic(info, journal_topic),
            _read_wanted(info, journal_topic),
            info,
            is_always_heard=False,
        ),
    )


class Inputs:
    """The checks of all inputs that are compared."""

    def __init__(
        self, odometry: InputCheck, battery: InputCheck, scan: InputCheck, wanted: InputCheck
    ) -> None:
        self._odometry = odometry
        self._battery = battery
        self._scan = scan
        self._wanted = wanted
        self._all = odometry, battery, scan, wanted

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return for each recorded topic what takes its messages."""
        return {each.topic: each.message for each in self._all if each.topic is not None}

    def step(self, event: Event, seq: int) -> None:
        """Take an event of the journal, with the number of its entry."""
        if isinstance(event, OdomReceived):
            self._odometry.received(event, seq)
        elif isinstance(event, BatteryReceived):
            self._battery.received(event, seq)
        elif isinstance(event, ScanReceived) and event.sequence:  # 0: before it was told
            self._scan.received(event, seq)
        elif isinstance(event, GuardedCommandReceived) and event.sequence:
            self._wanted.received(event, seq)

    def snapshot(self, has_proof: bool) -> None:
        """Take a snapshot."""
        for each in self._all:
            each.snapshot(has_proof)

    def stop(self) -> None:
        """Pause until the next snapshot."""
        for each in self._all:
            each.stop()

    def end(
        self, invariants: Invariants, ending: Callable[[str | None], Ending], end_ns: int
    ) -> None:
        """Report what differs; `ending(topic)` tells how the recording ends for a topic."""
        for each in self._all:
            each.end(invariants, ending(each.topic), end_ns)


_TYPES: Mapping[str, str] = {
    "odometry": "nav_msgs/msg/Odometry",
    "battery": "sensor_msgs/msg/BatteryState",
    "scan": "sensor_msgs/msg/LaserScan",
}


def _read_sectors(data: bytes) -> Any:
    from robotctl.cdr.scan import read_sectors  # here: it loads numpy

    return read_sectors(data)


def _scan_topic(info: RecordingInfo, journal_topic: str) -> str | None:
    """Return the topic of the scan where the kernel takes it: reading each scan costs time."""
    use = info.metadata.get(INFO_RECORD, {}).get("parameter.scan.use", Use.OFF.value)
    return None if use == Use.OFF.value else _topic(info, journal_topic, "scan", "scan")


def _guard_topic(info: RecordingInfo, journal_topic: str) -> str | None:
    """Return the topic of the wanted velocities, None if it is not recorded."""
    name = full_name(info, journal_topic, "guard_topic", "cmd_vel_nav")
    types = (topic.type_name for topic in info.topics if topic.name == name)
    return name if COMMAND_TYPES.intersection(types) else None


def _read_wanted(info: RecordingInfo, journal_topic: str) -> Callable[[bytes], Twist]:
    """Return what reads a wanted velocity, of either type; NaN for an unreadable one."""
    name = _guard_topic(info, journal_topic)
    is_stamped = any(each.name == name and each.type_name == TWIST_STAMPED for each in info.topics)
    decode = decode_twist_stamped if is_stamped else decode_twist

    def read(data: bytes) -> Twist:
        try:
            return decode(data)
        except struct.error:
            return Twist(nan, nan)

    return read


def _topic(info: RecordingInfo, journal_topic: str, kind: str, default: str) -> str | None:
    name = full_name(info, journal_topic, f"{kind}.topic", default)
    is_recorded = any(
        topic.name == name and topic.type_name == _TYPES[kind] for topic in info.topics
    )
    return name if is_recorded else None


def is_filtered(info: RecordingInfo) -> bool:
    """Return whether the configuration leaves topics out of the recording."""
    values = info.metadata.get(INFO_RECORD, {})
    return any(
        values.get(f"parameter.recording.{key}", _NOTHING) != _NOTHING
        for key in ("include", "exclude")
    )
