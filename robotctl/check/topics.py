"""The topics of the robot whose journal is checked, and messages paired with journal entries."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite
from typing import Final, Generic, NamedTuple, TypeVar

from robotctl.kernel.constants import COMMAND_TYPES
from robotctl.recording import RecordingInfo
from robotctl.recording.format.journal import TOPIC
from robotctl.recording.format.names import CLIP_RECORD, INFO_RECORD
from robotctl.recording.format.topics import LATCHED_QOS
from robotctl.recording.read.messages import Message
from robotctl.recording.write.recorder_options import TopicFilter

MAX_TEXT: Final = 100_000
"""Maximum length of a list of patterns."""


class InputTopic(NamedTuple):
    """The full name and type of an input's topic; `name` is None if the topic is not recorded.

    `is_left_out` is True if the recorder was configured to omit the topic.
    """

    name: str | None = None
    type_name: str = ""
    is_left_out: bool = False


def number_in(values: Mapping[str, str], key: str, default: float) -> float:
    """Return `values[key]` as a float; return `default` if it is missing or no finite number."""
    with suppress(KeyError, ValueError):
        value = float(values[key])
        return value if isfinite(value) else default
    return default


class RobotTopics:
    """The topics and services of the robot that made the journal, as the metadata names them."""

    def __init__(self, info: RecordingInfo, journal_topic: str) -> None:
        self.info = info
        self.values = info.metadata.get(INFO_RECORD, {})
        """The metadata of the recorder."""

        self.clip_begin_ns = number_in(info.metadata.get(CLIP_RECORD, {}), "start_ns", 0.0)
        """Begin of a clip [ns since the epoch], else 0; only its journal may have earlier times."""

        self.types = {topic.name: topic.type_name for topic in info.topics}
        self.namespace = journal_topic.removesuffix(f"/{TOPIC}")
        # Other topics that the recorder never leaves out are compared with the journal anyway.
        always = [self.named_by("odometry.topic", "odom")]
        self._filter = TopicFilter(self._patterns("include"), self._patterns("exclude"), always)

    def named_by(self, parameter: str, default: str) -> str:
        """Return the full name of the topic that a parameter names, in the robot's namespace."""
        name = self.values.get(f"parameter.{parameter}", default)
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def told(self, key: str) -> tuple[str, bool]:
        """Return the full name of a topic or service in the metadata under `key`, and True.

        If it is not there, return the last part of `key` in the robot's namespace, and False.
        """
        told = self.values.get(key)
        return told or f"{self.namespace}/{key.rpartition('.')[2]}", told is not None

    def recorded(self, parameter: str, default: str, *types: str) -> InputTopic:
        """Return the topic that a parameter names; its `name` is None if it is not recorded."""
        name = self.named_by(parameter, default)
        if self.types.get(name) in types:
            return InputTopic(name, self.types[name])
        return InputTopic(is_left_out=self.leaves_out(name, *types))

    @property
    def commands(self) -> str | None:
        """The name of the command topic, None if it is not recorded."""
        return self.recorded("command.topic", "cmd_vel", *COMMAND_TYPES).name

    def of_type(self, type_name: str) -> set[str]:
        """Return the recorded topics of a type."""
        return {name for name, each in self.types.items() if each == type_name}

    def is_latched(self, topic: str | None) -> bool:
        """Return whether a publisher of the topic offered transient local durability."""
        return any(t.name == topic and LATCHED_QOS in t.offered_qos for t in self.info.topics)

    def leaves_out(self, topic: str, *types: str) -> bool:
        """Return whether the configured patterns omit `topic` for at least one of `types`."""
        return not all(self._filter.records(topic, each) for each in types)

    def _patterns(self, key: str) -> list[str]:
        """Return the patterns in the metadata, or [] if they are not a list of strings."""
        text = self.values.get(f"parameter.recording.{key}", "[]")
        try:
            values = ast.literal_eval(text[:MAX_TEXT])
        except (ValueError, SyntaxError, RecursionError, MemoryError):
            return []
        is_list = isinstance(values, list) and all(isinstance(each, str) for each in values)
        return values if is_list else []


MAX_REPEATED: Final = 1_000
"""The maximum number of messages between a latched message and its repeat."""


class RepeatedLatched:
    """Counts the moments at which a recording repeats earlier messages of a latched topic.

    A new file repeats them: one moment is allowed per file or per snapshot, whichever are more.
    """

    def __init__(self, info: RecordingInfo) -> None:
        self._files = len(info.files)
        self._snapshots = 0
        self._seen: dict[int, tuple[int, int]] = {}
        """Message -> its last log time, number of its repeats at that time; the newest last."""

        self._repeats: set[tuple[int, int]] = set()
        """The counted repeats: log time, and the number of this repeat as in `_seen`."""

    def observe(self, message: Message) -> bool:
        """Observe a message; return whether it equals an earlier one, except in log time."""
        key = hash(message._replace(log_ns=0))  # a message may be large
        before_ns, count = self._seen.pop(key, (-1, -1))
        is_again = before_ns >= 0
        count = count + 1 if before_ns == message.log_ns else int(is_again)
        self._seen[key] = message.log_ns, count
        if len(self._seen) > MAX_REPEATED:
            del self._seen[next(iter(self._seen))]
        # A new file may repeat a message that waits to be written: it is recorded after its repeat.
        if (
            is_again
            and message.publish_ns <= before_ns <= message.log_ns
            and (before_ns == message.log_ns or (before_ns, 1) not in self._repeats)
        ):
            self._repeats.add((message.log_ns, count))
        return is_again

    def snapshot(self) -> None:
        """Count a snapshot of the journal; each one may explain one moment of repeats."""
        self._snapshots += 1

    @property
    def excess(self) -> int:
        """The number of repeats above the allowed number, or 0."""
        # Joined files keep their snapshots; a received journal has its snapshots elsewhere.
        return max(len(self._repeats) - max(self._files, self._snapshots), 0)


MAX_WAITING: Final = 20_000
"""The maximum number of slots in `Waiting`, several minutes of a topic."""

Entry = TypeVar("Entry")
Sent = TypeVar("Sent")


@dataclass(slots=True)
class Slot(Generic[Entry, Sent]):
    """The waiting journal entries and messages with one sequence number, from any publisher."""

    entries: list[Entry] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)


class Waiting(Generic[Entry, Sent]):
    """Journal entries and messages that wait to be compared, in one `Slot` per sequence number."""

    def __init__(self, judge: Callable[[int, Slot[Entry, Sent]], None]) -> None:
        """`judge` gets the oldest number and its slot when there are more than MAX_WAITING."""
        self._judge = judge
        self._slots: dict[int, Slot[Entry, Sent]] = {}

    def slot(self, number: int) -> Slot[Entry, Sent]:
        """Return the slot of `number`; if there are too many, pass the least recent to `judge`."""
        slot = self._slots.pop(number, None) or Slot()
        self._slots[number] = slot
        if len(self._slots) > MAX_WAITING:
            self._judge(*self._oldest())
        return slot

    def drop(self, number: int) -> None:
        """Remove the slot of sequence number `number` without calling `judge`."""
        self._slots.pop(number, None)

    def clear(self) -> None:
        """Remove all slots."""
        self._slots.clear()

    def rest(self) -> Iterator[tuple[int, Slot[Entry, Sent]]]:
        """Remove all slots and yield them."""
        while self._slots:
            yield self._oldest()

    def _oldest(self) -> tuple[int, Slot[Entry, Sent]]:
        number = next(iter(self._slots))
        return number, self._slots.pop(number)
