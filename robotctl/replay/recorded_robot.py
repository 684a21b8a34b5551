"""The recorded robot's pose, velocity, mode and path during a replay."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from math import hypot, isfinite
from typing import Any, Final

from robotctl.base.errors import UsageError
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Twist
from robotctl.messages.cdr import ODOMETRY, ROBOT_STATUS, CdrReader
from robotctl.messages.inputs import UNREADABLE, read_odometry
from robotctl.recording import Recording, TopicInfo
from robotctl.replay.timeline import Entry, Span, recorded

STEP_M: Final = 0.005
"""Minimum distance between points of the path."""

MAX_POINTS: Final = 4000
"""Maximum number of points in the path. Above it, every second one is removed."""


class RecordedRobot:
    """The state of the robot at a time of the recording. Unknown values are None, `path` is in [m].

    `advance` only goes forward in time. With `loop`, each new pass begins with an empty path.
    """

    def __init__(self, recording: Recording, span: Span, *, loop: bool) -> None:
        """Start at the beginning of `span`.

        Raises:
            UsageError: The recording has neither odometry nor status.
        """
        topics = recording.info().topics
        self.pose: Pose | None = None
        self.velocity: Twist | None = None
        self.mode: str | None = None
        self.path: list[tuple[float, float]] = []
        self._takes: dict[str, Callable[[bytes], None]] = {}
        types: dict[str, str] = {}
        for type_name, take in ((ODOMETRY, self._odometry), (ROBOT_STATUS, self._status)):
            topic = _busiest(topics, type_name)
            if topic is not None:
                self._takes[topic.name] = take
                types[topic.name] = type_name
        if not self._takes:
            raise UsageError(
                f"nothing to draw: the recording has neither {ODOMETRY} nor {ROBOT_STATUS}"
            )
        latched = dict.fromkeys(self._takes, 1)
        self._entries = recorded(recording, span, types, latched, lambda lost: None, loop=loop)
        self._next: Entry | None = next(self._entries, None)
        self._pass_ns = span.pass_ns
        self._pass = 0

    @property
    def next_ns(self) -> int | None:
        """The replay time of the next message, or None at the end."""
        return None if self._next is None else self._next[0]

    def status(self) -> dict[str, Any]:
        """Return the state with the keys of `robotctl status --json`."""
        return {
            "mode": self.mode,
            "pose": None if self.pose is None else asdict(self.pose),
            "velocity": None if self.velocity is None else asdict(self.velocity),
        }

    def advance(self, position_ns: int) -> None:
        """Update the state with all messages up to the replay time `position_ns`."""
        while self._next is not None and self._next[0] <= position_ns:
            at_ns, topic, data = self._next
            number = max(at_ns - 1, 0) // self._pass_ns
            if number != self._pass:
                self._pass, self.path = number, []
            with suppress(struct.error):  # a truncated message; the replay publishes it unchanged
                self._takes[topic](data)
            self._next = next(self._entries, None)

    def _odometry(self, data: bytes) -> None:
        odometry = read_odometry(data)
        if odometry is UNREADABLE:
            return
        self.pose, self.velocity = odometry.pose, odometry.velocity
        self._trace(odometry.pose.x, odometry.pose.y)

    def _trace(self, x: float, y: float) -> None:
        path = self.path
        if not (isfinite(x) and isfinite(y)):
            return
        if not path or hypot(x - path[-1][0], y - path[-1][1]) >= STEP_M:
            path.append((x, y))
        if len(path) > MAX_POINTS:
            del path[1:-1:2]

    def _status(self, data: bytes) -> None:
        message = CdrReader(data)
        message.text()
        (mode,) = message.take("B")
        self.mode = Mode(mode).name if mode in list(Mode) else f"mode {mode}"


def _busiest(topics: Sequence[TopicInfo], type_name: str) -> TopicInfo | None:
    """Return the topic of this type with the most messages, or None if there are no messages."""
    found = [topic for topic in topics if topic.type_name == type_name and topic.message_count]
    return max(found, key=lambda topic: topic.message_count, default=None)
