"""Velocity commands as the command topic of a recording carries them."""

from __future__ import annotations

import struct

from robotctl.errors import UnreadableFile
from robotctl.kernel.command_types import COMMAND_TYPES
from robotctl.kernel.types import Twist
from robotctl.recording import RecordingInfo
from robotctl.rerun.own_topics import full_name

_NUMBERS = struct.Struct("<6d")
_BIG_ENDIAN_NUMBERS = struct.Struct(">6d")
"""The six velocities at the end of a serialized message (CDR, OMG DDSI-RTPS 10.2)."""

STILL = bytes(_NUMBERS.size)
"""The numbers of a command of zero."""


def command_topic(info: RecordingInfo, journal_topic: str) -> str | None:
    """Return the topic of the velocity commands of the journal, None if it is not recorded."""
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
    """Return the six numbers of a command."""
    return _NUMBERS.pack(twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)


def shown_command(numbers: bytes) -> str:
    """Return the text of a command."""
    linear, _, _, _, _, angular = _NUMBERS.unpack(numbers)
    return f"{linear:.6g} m/s, {angular:.6g} rad/s"
