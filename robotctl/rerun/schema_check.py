"""Checks what the file tells of each topic's type: others read the messages by it, not the check.

A type has one hash, which its fields determine. So the text of a type and the hash that the file
tells contradict each other where one of them was changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Final

from mcap.records import Channel, Schema

from robotctl.cdr import known_types
from robotctl.cdr.definition import UnreadableType, parse_definition
from robotctl.cdr.type_hash import rihs01_hash
from robotctl.kernel import command_types
from robotctl.recording import Recording
from robotctl.recording.convert.installed_definition import installed_definition
from robotctl.recording.format.type_names import type_name_of
from robotctl.rerun.check_report import Report
from robotctl.rerun.invariants import Invariants

HASHES: Final[Mapping[str, str]] = {
    command_types.TWIST: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    command_types.TWIST_STAMPED: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    known_types.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    known_types.ROBOT_STATUS: "61598f9d2936bf0665499ce4f458aba4b3e12ede4281ea119ca421cde9331509",
    known_types.JOURNAL_ENTRY: "8ecaa1252cd850455be383c3a05c471a0dbe13d5fc23ae327afcc626da89175a",
    "robot_controller/srv/SetMode_Event": (
        "9e6dda1519f7f4c9b7773852b8742429baebad1dde87e67dcda45a04abedc813"
    ),
    "std_srvs/srv/Trigger_Event": (
        "ec4a1d26b0575e61906890342aba9523a2360e9845857c5590fa6e23bc39e1c2"
    ),
    "sensor_msgs/msg/BatteryState": (
        "4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
    ),
    "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "sensor_msgs/msg/Joy": "0d356c79cad3401e35ffeb75a96a96e08be3ef896b8b83841d73e890989372c5",
    "sensor_msgs/msg/Imu": "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "std_msgs/msg/Bool": "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "diagnostic_msgs/msg/DiagnosticArray": (
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
}
"""The hash of each type whose messages a check reads, without `RIHS01_`."""

_PREFIX: Final = "RIHS01_"
_ROS2MSG: Final = "ros2msg"
_HASH_KEY, _QOS_KEY = "topic_type_hash", "offered_qos_profiles"

_OWN: Final = frozenset({known_types.JOURNAL_ENTRY, known_types.ROBOT_STATUS})
"""The types of topics that only robotctl publishes: it always tells what it offers."""

_MAX_TEXT: Final = 1 << 20
"""Longer than any type of ROS; a recording may hold any text."""


def check_schemas(recording: Recording, report: Report, invariants: Invariants) -> None:
    """Compare schema and channel of each topic with its type."""
    for channel, schema in _channels(recording):
        name = type_name_of(channel, schema)
        if name in HASHES:
            _check_read(channel, schema, name, report, invariants)
        elif schema is not None and schema.encoding == _ROS2MSG:
            _check_other(channel, schema, name, report, invariants)


def _check_read(
    channel: Channel, schema: Schema | None, name: str, report: Report, invariants: Invariants
) -> None:
    """Check a topic of a type that the check reads by its own knowledge of the fields."""
    topic, told = channel.topic, channel.metadata.get(_HASH_KEY, "")
    if channel.message_encoding != "cdr" or (schema and schema.encoding not in (_ROS2MSG, "")):
        invariants.violate(f"the encoding of {topic} is not that of ROS messages")
        return
    if schema is None or not schema.data or not told:
        report.miss(f"{topic} is recorded without the definition of its type")
        return
    described = _hash_of(name, schema.data)
    if described != told:
        invariants.violate(_contradiction(topic, name))
    elif described != _PREFIX + HASHES[name]:
        report.miss(f"{topic} is recorded with another version of {name} than the check reads")
    elif name in _OWN and not channel.metadata.get(_QOS_KEY):
        report.miss(f"{topic} is recorded without its quality of service")


def _check_other(
    channel: Channel, schema: Schema, name: str, report: Report, invariants: Invariants
) -> None:
    """Check a topic of another type, as far as it is installed here."""
    topic, told = channel.topic, channel.metadata.get(_HASH_KEY, "")
    described = _hash_of(name, schema.data)
    if described == told or not told:
        return
    if _installed_hash(name) == told:
        invariants.violate(_contradiction(topic, name))
    else:
        report.notes.append(f"{_contradiction(topic, name)}, in a version that is not installed")


def _contradiction(topic: str, name: str) -> str:
    return f"the schema of {topic} does not describe the fields that {name} has"


def _channels(recording: Recording) -> Iterator[tuple[Channel, Schema | None]]:
    """Yield what the files tell of each topic; what they tell alike comes once."""
    told = set()
    for each in recording.open_files:
        for channel in each.index.channels.values():
            schema = each.index.schemas.get(channel.schema_id)
            key = (
                channel.topic,
                channel.message_encoding,
                *sorted(channel.metadata.items()),
                *((schema.name, schema.encoding, schema.data) if schema else ()),
            )
            if key not in told:
                told.add(key)
                yield channel, schema


@lru_cache(maxsize=256)
def _hash_of(type_name: str, text: bytes) -> str:
    """Return the hash of a type that is described so, "" if the text cannot be read."""
    if len(text) > _MAX_TEXT or type_name.count("/") != 2:
        return ""
    try:
        return rihs01_hash(type_name, parse_definition(type_name, text.decode(errors="replace")))
    except UnreadableType:
        return ""


@lru_cache(maxsize=256)
def _installed_hash(type_name: str) -> str:
    return _hash_of(type_name, installed_definition(type_name, "").encode())
