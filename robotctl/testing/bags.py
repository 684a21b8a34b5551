"""Recordings as other programs write them, with messages that ROS understands."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mcap.writer import Writer

START_NS: Final = 1_700_000_000_000_000_000

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

_LITTLE_ENDIAN: Final = b"\0\1\0\0"


@dataclass(frozen=True, slots=True)
class Line:
    """One message of a recording; `at_ms` after START_NS."""

    topic: str
    type_name: str
    at_ms: float
    data: bytes
    qos: str = VOLATILE
    encoding: str = "cdr"
    type_hash: str = ""


def text(content: str) -> bytes:
    """A serialized std_msgs/String."""
    encoded = content.encode() + b"\0"
    return padded(_LITTLE_ENDIAN + struct.pack("<I", len(encoded)) + encoded)


def padded(data: bytes) -> bytes:
    """A serialized message as DDS delivers it: in whole words of 4 bytes."""
    return data + bytes(-len(data) % 4)


def twist(linear: float, angular: float = 0.0) -> bytes:
    """A serialized geometry_msgs/Twist."""
    return _LITTLE_ENDIAN + struct.pack("<6d", linear, 0, 0, 0, 0, angular)


def write_bag(path: Path, lines: Iterable[Line], *, chunk_bytes: int = 1 << 20) -> Path:
    """Write a file with the messages in this order; returns its path."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_bytes)
        writer.start("ros2")
        channels: dict[tuple[str, str], int] = {}
        for number, line in enumerate(lines):
            key = line.topic, line.type_name
            if key not in channels:
                schema = writer.register_schema(line.type_name, "ros2msg", b"")
                metadata = {"offered_qos_profiles": line.qos, "topic_type_hash": line.type_hash}
                channels[key] = writer.register_channel(line.topic, line.encoding, schema, metadata)
            at_ns = START_NS + round(line.at_ms * 1e6)
            writer.add_message(channels[key], at_ns, line.data, at_ns, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
