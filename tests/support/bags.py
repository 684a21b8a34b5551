"""Recordings as other programs write them, with valid ROS messages."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest
from mcap.writer import Writer

START_NS: Final = 1_700_000_000_000_000_000

SAMPLES: Final = Path(__file__).parents[3] / "shared" / "samples" / "rosbag2"
"""Bags that rosbag2 wrote; not every machine has them."""

needs_samples = pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"no sample bags at {SAMPLES}")

VOLATILE: Final = """\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
"""
LATCHED: Final = VOLATILE.replace("volatile", "transient_local").replace("10", "1")
SENSOR: Final = VOLATILE.replace(": reliable", ": best_effort")

TWIST: Final = "geometry_msgs/msg/Twist"
STRING: Final = "std_msgs/msg/String"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
STATUS: Final = "robot_controller/msg/RobotStatus"

OTHER_HASH: Final = "RIHS01_" + "ab" * 32
"""A hash that no installed type has."""

_LITTLE_ENDIAN: Final = b"\0\1\0\0"


@dataclass(frozen=True, slots=True)
class Line:
    """One message of a recording; its log time is `at_ms` after START_NS."""

    topic: str
    type_name: str
    at_ms: float
    data: bytes
    qos: str = VOLATILE
    encoding: str = "cdr"
    type_hash: str = ""
    definition: str = ""


def text(content: str) -> bytes:
    """Return a serialized std_msgs/String."""
    encoded = content.encode() + b"\0"
    return padded(_LITTLE_ENDIAN + struct.pack("<I", len(encoded)) + encoded)


def padded(data: bytes) -> bytes:
    """Return a serialized message padded to a multiple of 4 bytes, as DDS delivers it."""
    return data + bytes(-len(data) % 4)


def twist(linear: float, angular: float = 0.0) -> bytes:
    """Return a serialized geometry_msgs/Twist."""
    return _LITTLE_ENDIAN + struct.pack("<6d", linear, 0, 0, 0, 0, angular)


def odometry(at_ms: float, x: float, *, endian: str = "<") -> Line:
    """Return odometry at (x, 2 x), heading 0, with frame names that need padding."""
    data = b"\0\1\0\0" if endian == "<" else b"\0\0\0\0"
    data += struct.pack(f"{endian}iI", 1, 2)
    for name in (b"odom\0", b"base_link\0"):
        data += bytes(-len(data) % 4) + struct.pack(f"{endian}I", len(name)) + name
    data += bytes((4 - len(data)) % 8)
    data += struct.pack(
        f"{endian}7d36d6d36d", x, 2 * x, 0, 0, 0, 0, 1, *[0.0] * 36, 0.25, *[0] * 41
    )
    return Line("/odom", ODOMETRY, at_ms, data)


def status(at_ms: float, mode: int) -> Line:
    """Return a RobotStatus with this mode."""
    data = b"\0\1\0\0" + struct.pack("<I6sBxffB", 6, b"robot\0", mode, 0.5, 40.0, 1)
    return Line("/robot_status", STATUS, at_ms, data, LATCHED)


def talk(topic: str, count: int, period_ms: float = 5.0, **fields: str) -> list[Line]:
    """Return `count` strings on a topic, one each `period_ms`."""
    return [
        Line(topic, STRING, number * period_ms, text(f"{topic} {number}"), **fields)
        for number in range(count)
    ]


def in_order(*topics: list[Line]) -> list[Line]:
    """Return the lines of several topics in the order of their times."""
    return sorted((line for topic in topics for line in topic), key=lambda line: line.at_ms)


def data(lines: list[Line]) -> list[bytes]:
    """Return the serialized message of each line."""
    return [line.data for line in lines]


def write_bag(path: Path, lines: Iterable[Line], *, chunk_bytes: int = 1 << 20) -> Path:
    """Write an MCAP file with the messages in this order; return its path."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_bytes)
        writer.start("ros2")
        channels: dict[tuple[str, str], int] = {}
        for number, line in enumerate(lines):
            key = line.topic, line.type_name
            if key not in channels:
                definition = line.definition.encode()
                schema = writer.register_schema(line.type_name, "ros2msg", definition)
                metadata = {"offered_qos_profiles": line.qos, "topic_type_hash": line.type_hash}
                channels[key] = writer.register_channel(line.topic, line.encoding, schema, metadata)
            at_ns = START_NS + round(line.at_ms * 1e6)
            writer.add_message(channels[key], at_ns, line.data, at_ns, number)
        writer.finish()
    return path
