"""The topics of the robot whose journal is checked: names, recording filter, latched repeats."""

from __future__ import annotations

import ast
from typing import Final, NamedTuple

from robotctl.recording import RecordingInfo
from robotctl.recording.format.journal import TOPIC
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.read.messages import Message
from robotctl.recording.write.recorder_options import TopicFilter


def full_name(info: RecordingInfo, journal_topic: str, parameter: str, default: str) -> str:
    """Return the full name of the topic that a parameter names, in the journal's namespace."""
    name = info.metadata.get(INFO_RECORD, {}).get(f"parameter.{parameter}", default)
    if name.startswith("/"):
        return name
    return f"{journal_topic.removesuffix(f'/{TOPIC}')}/{name}"


def own_name(info: RecordingInfo, journal_topic: str, key: str) -> tuple[str, bool]:
    """Return the full name of a topic or service, and whether the metadata has it under `key`.

    If the metadata does not have it, the name is the last part of `key`.
    """
    told = info.metadata.get(INFO_RECORD, {}).get(key)
    namespace = journal_topic.removesuffix(f"/{TOPIC}")
    return told or f"{namespace}/{key.rpartition('.')[2]}", told is not None


MAX_TEXT: Final = 100_000
"""The longest list of patterns that is read."""


class RecordedFilter:
    """Tells which topics the recorder left out, by the patterns in the recording's metadata.

    The odometry topic of the journal's robot counts as recorded in any case.
    """

    def __init__(self, info: RecordingInfo, journal_topic: str) -> None:
        # Other topics that the recorder never leaves out are compared with the journal anyway.
        always = [full_name(info, journal_topic, "odometry.topic", "odom")]
        self._filter = TopicFilter(_patterns(info, "include"), _patterns(info, "exclude"), always)

    def leaves_out(self, topic: str, *types: str) -> bool:
        """Return whether the recorder left out the topic, if it has one of these types."""
        return not all(self._filter.records(topic, each) for each in types)


def _patterns(info: RecordingInfo, key: str) -> list[str]:
    """Return the patterns in the metadata, or [] if they are not a list of strings."""
    text = info.metadata.get(INFO_RECORD, {}).get(f"parameter.recording.{key}", "[]")
    try:
        values = ast.literal_eval(text[:MAX_TEXT])
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        return []
    is_list = isinstance(values, list) and all(isinstance(each, str) for each in values)
    return values if is_list else []


class InputTopic(NamedTuple):
    """A topic: its full name, None if it is not recorded, and its recorded type.

    `is_left_out` says that it is not recorded because the recorder was configured to omit it.
    """

    name: str | None = None
    type_name: str = ""
    is_left_out: bool = False


class InputTopics:
    """Looks up topics of the robot that made the journal."""

    def __init__(self, info: RecordingInfo, journal_topic: str) -> None:
        self._info = info
        self._journal_topic = journal_topic
        self._filter = RecordedFilter(info, journal_topic)

    def of(self, parameter: str, default: str, *types: str) -> InputTopic:
        """Return the topic that a parameter names, if it is recorded with one of these types."""
        name = full_name(self._info, self._journal_topic, parameter, default)
        for topic in self._info.topics:
            if topic.name == name and topic.type_name in types:
                return InputTopic(name, topic.type_name)
        return InputTopic(is_left_out=self._filter.leaves_out(name, *types))


class RepeatedLatched:
    """Counts the messages of a latched topic that repeat the message before them.

    Each file begins with one such repeat and a snapshot, so that no more repeats than snapshots are
    allowed, even in joined files. A journal that was received has its snapshots elsewhere: there,
    as many repeats as files are allowed.
    """

    def __init__(self, info: RecordingInfo) -> None:
        self._files = len(info.files)
        self._snapshots = 0
        self._last: Message | None = None
        self._count = 0

    def observe(self, message: Message) -> bool:
        """Observe a message; return whether it repeats the one before it."""
        last, self._last = self._last, message
        is_again = last is not None and last._replace(log_ns=message.log_ns) == message
        self._count += is_again
        return is_again

    def count(self) -> None:
        """Count a repeat that comes before the message that it repeats."""
        self._count += 1

    def snapshot(self) -> None:
        """Count a snapshot."""
        self._snapshots += 1

    @property
    def excess(self) -> int:
        """The number of repeats beyond one for the beginning of each file."""
        return max(self._count - max(self._files, self._snapshots), 0)
