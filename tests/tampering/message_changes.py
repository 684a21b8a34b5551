"""Changes of single messages: each returns a message as a forger leaves it."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from robotctl.kernel.modes import Mode
from tests.support.edited_recordings import Contents, Stored

AT_MODE = 4 + 4 + len(b"robot\0")
"""The place of the mode in a status."""

AT_REQUESTED, AT_SUCCESS = 48, 52
"""The places of the mode in a call and of the success in a response of a service."""


def late(message: Stored) -> Stored:
    """Send a message 2 s later."""
    return replace(message, publish_ns=message.publish_ns + 2 * 10**9)


def early(message: Stored) -> Stored:
    """Send a message 2 s earlier."""
    return replace(message, publish_ns=message.publish_ns - 2 * 10**9)


def moved(message: Stored, random: Random) -> Stored:
    """Change the position, by one bit of any weight."""
    data = bytearray(message.data)
    at = len(data) - 8 * (36 + 6 + 36 + 7) + random.randrange(6)
    data[at] ^= 1 << random.randrange(8)
    return replace(message, data=bytes(data))


def level(message: Stored, random: Random) -> Stored:
    """Change the battery level."""
    data = bytearray(message.data)
    data[-4] ^= 1 << random.randrange(8)
    return replace(message, data=bytes(data))


def last_number(contents: Contents, topic: str) -> int:
    """Return the number of the last message of a topic."""
    return max(each.sequence for each in contents.messages if each.topic == topic)


def not_first(message: Stored) -> bool:
    """Accept any message but the first."""
    return message.sequence > 1


def not_last(message: Stored) -> bool:
    """Accept the messages that were not under way at the end: a recording has 180 of odometry."""
    return message.sequence < 150


def mode(message: Stored, random: Random) -> Stored:
    """Show a mode that the robot never had."""
    data = bytearray(message.data)
    data[AT_MODE] = Mode.ERROR
    return replace(message, data=bytes(data))


def with_mode(message: Stored, shown: Mode) -> Stored:
    """Show a mode."""
    data = bytearray(message.data)
    data[AT_MODE] = shown.value
    return replace(message, data=bytes(data))


def shown_level(message: Stored, random: Random) -> Stored:
    """Show another battery level."""
    data = bytearray(message.data)
    data[-9] ^= 1 << random.randrange(8)
    return replace(message, data=bytes(data))


def robot(message: Stored, random: Random) -> Stored:
    """Show the status of another robot."""
    return replace(message, data=message.data.replace(b"robot", b"rabot"))


def numbered(message: Stored, random: Random) -> Stored:
    """Give a message another number."""
    return replace(message, sequence=message.sequence + 5_000)


def requested(message: Stored, random: Random) -> Stored:
    """Request another mode."""
    data = bytearray(message.data)
    data[AT_REQUESTED] ^= 1
    return replace(message, data=bytes(data))


def granted(message: Stored, random: Random) -> Stored:
    """Answer the opposite."""
    data = bytearray(message.data)
    data[AT_SUCCESS] ^= 1
    return replace(message, data=bytes(data))
