"""Compares the recorded velocity commands with the journal: every motion must be decided."""

from __future__ import annotations

import struct
from collections import deque

from robotctl.errors import UnreadableFile
from robotctl.kernel.types import Effect, PublishTwist, Twist
from robotctl.recording import RecordingInfo
from robotctl.recording.format.journal import TOPIC
from robotctl.recording.format.metadata_names import INFO_RECORD

TYPES = frozenset({"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"})
"""The message types of a command; both end with the same six numbers."""

MAX_WAITING = 512
"""The number of commands that may wait for their counterpart."""

STILL_STEPS = 500
"""After this many steps with effects but without motion, no command can still be under way."""

_NUMBERS = struct.Struct("<6d")
_BIG_ENDIAN_NUMBERS = struct.Struct(">6d")
"""The six velocities at the end of a serialized message (CDR, OMG DDSI-RTPS 10.2)."""

_STILL = bytes(_NUMBERS.size)

_COMMAND_TOPIC = "parameter.command.topic"


def command_topic(info: RecordingInfo, journal_topic: str) -> str | None:
    """Return the topic of the velocity commands of the journal, None if it is not recorded."""
    name = info.metadata.get(INFO_RECORD, {}).get(_COMMAND_TOPIC, "cmd_vel")
    if not name.startswith("/"):
        name = f"{journal_topic.removesuffix(f'/{TOPIC}')}/{name}"
    recorded = {topic.name for topic in info.topics if topic.type_name in TYPES}
    return name if name in recorded else None


def is_still(data: bytes) -> bool:
    """Return whether a message of the command topic commands no motion."""
    return not any(_NUMBERS.unpack(_numbers(data)))


class CommandTraffic:
    """The comparison of published and decided commands: by value, in any order, each once.

    Commands of zero are ignored: they are always allowed.
    """

    def __init__(self) -> None:
        self.seen = 0
        self.undecided = 0
        """The number of commands, other than zero, without a decision."""

        self.example = ""
        """The first of them, as text."""

        self._decided: deque[bytes] = deque(maxlen=MAX_WAITING)
        self._published: deque[bytes] = deque()
        self._still_steps = 0

    def message(self, data: bytes) -> None:
        """Take a message of the command topic."""
        self.seen += 1
        numbers = _numbers(data)
        if numbers == _STILL:
            return
        try:
            self._decided.remove(numbers)
        except ValueError:
            if not any(_NUMBERS.unpack(numbers)):  # a negative zero
                return
            self._published.append(numbers)
            if len(self._published) > MAX_WAITING:
                self._give_up()

    def step(self, effects: tuple[Effect, ...]) -> None:
        """Take the effects of one step."""
        self._still_steps += 1
        for effect in effects:
            if isinstance(effect, PublishTwist) and (effect.twist.linear or effect.twist.angular):
                self._still_steps = 0
                numbers = _serialized(effect.twist)
                try:
                    self._published.remove(numbers)
                except ValueError:
                    self._decided.append(numbers)
        if self._still_steps == STILL_STEPS:
            self._decided.clear()
            self.end()

    def end(self) -> None:
        """Count all commands that still wait for a decision: no decision follows."""
        while self._published:
            self._give_up()

    def _give_up(self) -> None:
        numbers = self._published.popleft()
        self.undecided += 1
        if not self.example:
            linear, _, _, _, _, angular = _NUMBERS.unpack(numbers)
            self.example = f"{linear:.6g} m/s, {angular:.6g} rad/s"


def _numbers(data: bytes) -> bytes:
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


def _serialized(twist: Twist) -> bytes:
    return _NUMBERS.pack(twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)
