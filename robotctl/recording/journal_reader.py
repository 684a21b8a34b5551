"""The journal in a recording, as its kernel wrote it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.paths import DEFAULT_ROBOT, namespace_of
from robotctl.recording.identity import INFO_RECORD
from robotctl.recording.journal import TOPIC, TYPE_NAME, JournalEntry, decode
from robotctl.recording.reader import Recording, RecordingInfo


class Journaled(NamedTuple):
    """An entry and when it was recorded, in nanoseconds since the epoch."""

    log_ns: int
    entry: JournalEntry


def journal_topic(info: RecordingInfo) -> str | None:
    """The topic with the journal of the robot that recorded, None where there is none.

    In the same ROS domain another robot's journal may have been recorded as well.
    """
    robot = info.metadata.get(INFO_RECORD, {}).get("robot", DEFAULT_ROBOT)
    own = f"{namespace_of(robot)}/{TOPIC}"
    found = {topic.name for topic in info.topics if topic.type_name == TYPE_NAME}
    if own in found:
        return own
    return found.pop() if len(found) == 1 else None


def read_journal(recording: Recording, on_missing: Callable[[str], None]) -> Iterator[Journaled]:
    """The entries in the order in which they were written, which is that of their `seq`.

    Log times may step back where the clock was set. What cannot be read is told to `on_missing`.
    Raises UnreadableFile where there is no journal, or an entry is none.
    """
    topic = journal_topic(recording.info())
    if topic is None:
        raise UnreadableFile(f"{recording.path} holds no journal of robotctl")
    for message in recording.in_order_written({topic}, on_missing):
        yield Journaled(message.log_ns, decode(message.data))
