"""Recordings of simulated drives with the messages that the kernel received, made without ROS."""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import nan
from typing import Any

from mcap.records import Channel, Schema

from robotctl.check.closed_loop import closed_loop
from robotctl.config import Config
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.types import Effect, Event
from robotctl.messages.cdr import ENCAPSULATION
from robotctl.messages.inputs import MESSAGE_TYPES
from robotctl.messages.installed import installed_type
from robotctl.recording.format.journal import decode
from robotctl.recording.format.names import INFO_RECORD, LEDGER_RECORD
from robotctl.sim import SimParams
from robotctl.testing.drives import BEGIN_NS, QOS, drive_requested, journaled
from robotctl.testing.hearing import BATTERY, ODOMETRY, SCAN, WANTED, HearingKernel
from robotctl.testing.hearing import TOPICS as SAFETY_TOPICS
from tests.support.edited_recordings import Contents, Stored, recorded

SET_MODE, ESTOP = "/set_mode/_service_event", "/estop/_service_event"

PERFECT = SimParams(
    lag_s=0.0,
    actuation_linear_factor=1.0,
    actuation_angular_factor=1.0,
    actuation_noise=0.0,
    odometry_linear_factor=1.0,
    odometry_angular_factor=1.0,
    odometry_noise=0.0,
)
"""A robot that does what it is told, and reports what it does."""

_HEAD = struct.Struct("<4sBxxxiI16sxxxxq")
_CLIENT = b"\x01" * 16


def received(number: int, requested: int | None) -> bytes:
    """Return a service event: request `number` for a mode, None for `estop`."""
    head = _HEAD.pack(ENCAPSULATION, 1, 0, 0, _CLIENT, number)
    return head + struct.pack("<IBxxxI", 1, requested or 0, 0)


def sent(number: int, ok: bool, text: str, mode: int | None) -> bytes:
    """Return a service event: the response to request `number`; `mode` is None for `estop`."""
    head = _HEAD.pack(ENCAPSULATION, 2, 0, 0, _CLIENT, number)
    message = text.encode() + b"\0"
    data = head + struct.pack("<IIBxxxI", 0, 1, ok, len(message)) + message
    return data if mode is None else data + bytes([mode])


COMMANDS, JOURNAL, STATUS = "/cmd_vel", "/robotctl/journal", "/robot_status"

_TOPICS = {
    "OdomReceived": ODOMETRY,
    "BatteryReceived": BATTERY,
    "ScanReceived": SCAN,
    "GuardedCommandReceived": WANTED,
}


def heard_drive(
    seconds: float = 3.0,
    *,
    requests: Sequence[Event] | None = None,
    snapshots_s: Iterable[float] = (0.0,),
    config: Config | None = None,
) -> Contents:
    """Return the contents of a recorded drive, with all messages that a check compares."""
    config = config or Config()
    kernel = HearingKernel(config)
    asked = [drive_requested()] if requests is None else requests
    asked = sorted(asked, key=lambda event: event.t_ns)
    end_ns = BEGIN_NS + round(seconds * NS_PER_S)

    def steps() -> Iterable[tuple[Event, tuple[Effect, ...]]]:
        for _, effects in closed_loop(kernel, config.sim, asked, BEGIN_NS):
            assert kernel.heard is not None
            yield kernel.heard, effects
            if kernel.heard.t_ns >= end_ns:
                return

    snapshots_ns = [BEGIN_NS + round(after_s * NS_PER_S) for after_s in snapshots_s]
    written = journaled(kernel, steps(), snapshots_ns)
    return _with_messages(recorded(written, config), kernel.messages)


def status(mode: int, level: float, name: bytes = b"robot", *, is_connected: bool = True) -> bytes:
    """Return a serialized RobotStatus."""
    head = struct.pack("<4sI", ENCAPSULATION, len(name) + 1) + name + b"\0"
    head += struct.pack("<B", mode)
    head += bytes(-len(head) % 4)
    return head + struct.pack("<ff?", level, 40.0, is_connected)


def _with_messages(contents: Contents, heard: dict[tuple[str, int], bytes]) -> Contents:
    """Add received and published messages, each a few entries late, as the recorder does."""
    _add_topic(contents, BATTERY, "sensor_msgs/msg/BatteryState")
    if (SCAN, 1) in heard:
        _add_topic(contents, SCAN, "sensor_msgs/msg/LaserScan")
    if (WANTED, 1) in heard:
        _add_topic(contents, WANTED, "geometry_msgs/msg/Twist")
    for kind, safety_topic in SAFETY_TOPICS.items():
        if (safety_topic, 1) in heard:
            _add_topic(contents, safety_topic, MESSAGE_TYPES[kind])
    _add_topic(contents, STATUS, "robot_controller/msg/RobotStatus")
    _add_topic(contents, SET_MODE, "robot_controller/srv/SetMode_Event")
    _add_topic(contents, ESTOP, "std_srvs/srv/Trigger_Event")
    messages: list[Stored] = []
    late: list[Stored] = []
    calls = _Calls()
    mode, level, shown, due_ns, is_connected = Mode.IDLE.value, nan, 0, 0, False
    for each in contents.messages:
        messages.append(each)
        if each.topic != JOURNAL:
            continue
        entry = decode(each.data)
        values = json.loads(entry.data)
        topic = _topic_of(entry.name, values)
        if topic is not None:
            sequence = values["sequence"]
            data = heard[topic, sequence]
            late.append(Stored(topic, data, each.log_ns, each.log_ns, sequence))
            level = values["level"] if topic == BATTERY else level
            is_connected |= topic == ODOMETRY
        late += calls.of(entry.name, values, each.log_ns)
        is_change = entry.name == "ModeChanged"
        mode = values["mode"] if is_change else mode
        if is_change or entry.t_ns >= due_ns:
            shown, due_ns = shown + 1, entry.t_ns + NS_PER_S
            data = status(mode, level, is_connected=is_connected)
            late.append(Stored(STATUS, data, each.log_ns, each.log_ns, shown))
        if len(late) >= 3:
            messages += late
            late = []
    contents.messages = messages + late
    told = next(values for name, values in contents.metadata if name == INFO_RECORD)
    told |= {
        "topic.robot_status": STATUS,
        "service.set_mode": "/set_mode",
        "service.estop": "/estop",
    }
    return _counted(contents)


def _topic_of(name: str, values: dict[str, Any]) -> str | None:
    """Return the topic of the message that caused an event, None if no message did."""
    if name == "SafetyInputReceived":
        return SAFETY_TOPICS[SafetyInput(values["kind"])]
    return _TOPICS.get(name)


class _Calls:
    """Makes the service events of the calls that the journal contains."""

    def __init__(self) -> None:
        self._open: dict[int, str] = {}
        self._counts = Counter[str]()

    def of(self, name: str, values: dict[str, Any], log_ns: int) -> Iterator[Stored]:
        """Yield the service event of a journal entry, if the entry has one."""
        number = values.get("request_id", 0)
        if name == "ModeRequested" and values["source"].startswith("the ROS service "):
            topic = f"{values['source'].removeprefix('the ROS service ')}/_service_event"
            self._open[number] = topic
            yield self._stored(topic, received(number, values["requested"]), log_ns)
        elif name == "Reply" and number in self._open:
            topic = self._open.pop(number)
            text = values["message"]
            if values["remedies"]:
                text += ": release it: robotctl reset"
            data = sent(number, values["ok"], text, values["mode"] if topic == SET_MODE else None)
            yield self._stored(topic, data, log_ns)

    def _stored(self, topic: str, data: bytes, log_ns: int) -> Stored:
        self._counts[topic] += 1
        return Stored(topic, data, log_ns, log_ns, self._counts[topic])


def _add_topic(contents: Contents, topic: str, type_name: str) -> None:
    text, type_hash = installed_type(type_name)
    schema = Schema(id=0, name=type_name, encoding="ros2msg", data=text.encode())
    values = {"topic_type_hash": type_hash, "offered_qos_profiles": QOS}
    channel = Channel(id=0, topic=topic, message_encoding="cdr", schema_id=0, metadata=values)
    contents.types.append((channel, schema))


def _counted(contents: Contents) -> Contents:
    """Return the contents with a ledger that counts all messages."""
    again = replace(contents)
    ledger = next(values for name, values in again.metadata if name == LEDGER_RECORD)
    for topic in (channel.topic for channel, _ in again.types):
        count = again.counts[topic]
        counts = dict.fromkeys(("received", "written", "queued", "dropped", "lost", "unseen"), 0)
        counts |= json.loads(ledger.get(topic, "{}"))
        ledger[topic] = json.dumps({**counts, "received": count, "written": count})
    return again
