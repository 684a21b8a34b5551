"""Read the journal of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import dropwhile
from typing import NamedTuple

from robotctl.base.errors import IN_PARENTHESES, UnreadableFile
from robotctl.base.paths import DEFAULT_ROBOT, namespace_of
from robotctl.kernel.constants import NS_PER_S
from robotctl.messages.cdr import JOURNAL_ENTRY
from robotctl.recording.format.journal import SHADOW_TOPIC, TOPIC, EntryKind, JournalEntry, decode
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.read.messages import Message
from robotctl.recording.read.read_limits import CURE
from robotctl.recording.read.reader import Recording, RecordingInfo

_FIRST_STEP_NS = 15 * NS_PER_S
"""Range of the first search for a snapshot. Daemons write one every 10 s."""


class RecordedEntry(NamedTuple):
    """A journal entry with its log time [ns since the epoch]."""

    log_ns: int
    entry: JournalEntry


class EntryDecoder:
    """Decodes the journal entries of a recording, as many as its read limits allow."""

    def __init__(self, recording: Recording) -> None:
        limits = self._limits = recording.limits
        self._entries_left = limits.journal_entries
        self._snapshots_left = limits.snapshots
        self._text_bytes_left = limits.journal_text_bytes

    def decode(self, serialized: bytes) -> JournalEntry:
        """Return the entry in `serialized`, the data of a journal message.

        Raises:
            UnreadableFile: The data is not an entry, or the limits are exceeded.
        """
        self._entries_left -= 1
        if self._entries_left < 0:
            raise _beyond(f"{self._limits.journal_entries} entries")
        self._text_bytes_left -= len(serialized)
        if self._text_bytes_left < 0:
            raise _beyond(f"{self._limits.journal_text_bytes >> 20} MiB of text")
        entry = decode(serialized)
        if entry.kind is EntryKind.SNAPSHOT:
            self._snapshots_left -= 1
            if self._snapshots_left < 0:
                raise _beyond(f"{self._limits.snapshots} snapshots")
        return entry


def _beyond(limit: str) -> UnreadableFile:
    return UnreadableFile(
        f"its journal is read only up to {limit}, the limit for a file of its size",
        CURE,
        sentence=IN_PARENTHESES,
    )


def journal_topic(info: RecordingInfo) -> str | None:
    """Return the journal topic of the robot that recorded, else the only journal topic, or None."""
    own, found = own_journal_topic(info), journal_topics(info)
    return own if own in found else found.pop() if len(found) == 1 else None


def journal_topics(info: RecordingInfo) -> set[str]:
    """Return the topics with a journal, of any robot."""
    return {
        topic.name
        for topic in info.topics
        if topic.type_name == JOURNAL_ENTRY and not topic.name.endswith(f"/{SHADOW_TOPIC}")
    }


def own_journal_topic(info: RecordingInfo) -> str:
    """Return the name of the recording robot's journal topic, whether it was recorded or not."""
    robot = info.metadata.get(INFO_RECORD, {}).get("robot", DEFAULT_ROBOT)
    return f"{namespace_of(robot)}/{TOPIC}"


def read_journal(
    recording: Recording,
    on_missing: Callable[[str], None],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[RecordedEntry]:
    """Yield the entries in file order.

    Log times step back if the clock was set back. `on_missing` gets a sentence about each part that
    cannot be read, `on_progress` the bytes read and in total.

    Raises:
        UnreadableFile: There is no journal, or an entry is damaged.
    """
    topic = journal_topic(recording.info())
    if topic is None:
        raise UnreadableFile(f"{recording.path} holds no journal of robotctl")
    decoder = EntryDecoder(recording)
    for message in recording.in_order_written({topic}, on_missing, on_progress):
        yield RecordedEntry(message.log_ns, decoder.decode(message.data))


def since_snapshot(
    recording: Recording, moment_ns: int, on_missing: Callable[[str], None]
) -> list[Message]:
    """Return the journal before `moment_ns` from its last snapshot on, [] without a snapshot."""
    info = recording.info()
    topic = journal_topic(info)
    if topic is None or moment_ns <= info.start_ns:
        return []
    begin_ns = _last_snapshot_ns(recording, topic, info.start_ns, moment_ns)
    messages = recording.messages({topic}, on_missing, (begin_ns, moment_ns - 1))
    return list(dropwhile(lambda each: not _is_snapshot(each), messages))


def _last_snapshot_ns(recording: Recording, topic: str, start_ns: int, moment_ns: int) -> int:
    """Return the log time of the last snapshot before `moment_ns`, or else `start_ns`."""
    step_ns = _FIRST_STEP_NS
    while True:
        begin_ns = max(moment_ns - step_ns, start_ns)
        window = (begin_ns, moment_ns - 1)
        found = [
            message.log_ns
            for message in recording.messages({topic}, lambda sentence: None, window)
            if _is_snapshot(message)
        ]
        if found or begin_ns == start_ns:
            return max(found, default=start_ns)
        step_ns *= 2


def _is_snapshot(message: Message) -> bool:
    try:
        return decode(message.data).kind is EntryKind.SNAPSHOT
    except UnreadableFile:
        return False
