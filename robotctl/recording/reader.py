"""Opening any MCAP recording: one file, or a folder as rosbag2 lays it out.

A file without a valid summary is scanned. What cannot be read is never passed over in silence:
it stands in `RecordingInfo.missing`, or ends the iteration over messages with UnreadableFile.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from types import TracebackType
from typing import Self

from mcap.records import Channel, Metadata, Schema

from robotctl.errors import UnreadableFile
from robotctl.recording import rosbag2
from robotctl.recording.events import RecordedEvent, events_in
from robotctl.recording.file_index import FileIndex, note_missing
from robotctl.recording.indexing import index_of
from robotctl.recording.lookback import last_before
from robotctl.recording.mcap_input import Damaged, InputFile
from robotctl.recording.merge import in_order_written, merge
from robotctl.recording.source import ALWAYS, Message, OpenFile, Window

__all__ = [
    "Message",
    "Recording",
    "RecordingInfo",
    "TopicInfo",
    "read_info",
    "read_messages",
]

_QOS_KEY = "offered_qos_profiles"
_HASH_KEY = "topic_type_hash"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a recording says about a topic; `rate_hz` is the mean over the whole recording."""

    name: str
    type_name: str
    message_count: int
    rate_hz: float
    encoding: str
    offered_qos: str
    type_hash: str
    schema_encoding: str
    definition: str


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What a recording holds; times in nanoseconds since the epoch, 0 without messages.

    `missing` says, a sentence each, what cannot be read; `indexed` is False where a file had no
    valid summary, so that it had to be scanned. `metadata` has the last record of each name.
    """

    path: Path
    files: tuple[Path, ...]
    size_bytes: int
    start_ns: int
    end_ns: int
    message_count: int
    topics: tuple[TopicInfo, ...]
    profile: str
    library: str
    metadata: dict[str, dict[str, str]]
    events: tuple[RecordedEvent, ...]
    indexed: bool
    missing: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end_ns - self.start_ns) / 1e9


def read_info(path: Path) -> RecordingInfo:
    """What `path` holds, a file or a folder. Raises UnreadableFile if nothing can be read."""
    with Recording(path) as recording:
        return recording.info()


def read_messages(
    path: Path,
    topics: Collection[str] | None = None,
    on_missing: Callable[[str], None] | None = None,
) -> Iterator[Message]:
    """The messages in the order of their log time; of `topics` only, if given.

    What cannot be read is told to `on_missing`, a sentence each; without it the iteration ends
    with UnreadableFile after the last message that can be read.
    """
    missing: list[str] = []
    tell = on_missing or (lambda sentence: note_missing(missing, sentence))
    with Recording(path) as recording:
        for sentence in recording.missing:
            tell(sentence)
        yield from recording.messages(topics, tell)
        if missing:
            raise UnreadableFile(f"{path} is incomplete: {'; '.join(missing)}")


class Recording:
    """An open recording. Close it, or use it in a `with` block."""

    def __init__(
        self, path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
    ) -> None:
        """Open `path`; `on_progress` gets bytes done and in total where files are scanned.

        Raises UnreadableFile if nothing can be read.
        """
        self.path = path
        self._files: list[OpenFile] = []
        self.missing: list[str] = []
        paths = recording_files(path)
        if paths != [path]:
            for sentence in absent_files(path, paths):
                note_missing(self.missing, sentence)
        try:
            for each in paths:
                self._open(each, only=paths == [path], on_progress=on_progress)
        except BaseException:
            self.close()
            raise
        if not self._files:
            raise UnreadableFile(f"{path} cannot be read: {'; '.join(self.missing)}")

    def close(self) -> None:
        """Close the files."""
        for each in self._files:
            each.file.close()

    def __enter__(self) -> Self:
        """The recording itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def info(self) -> RecordingInfo:
        """What it holds."""
        indexes = [each.index for each in self._files]
        with_messages = [index for index in indexes if index.message_count]
        start_ns = min((index.start_ns for index in with_messages), default=0)
        end_ns = max((index.end_ns for index in with_messages), default=0)
        metadata = self.metadata()
        return RecordingInfo(
            path=self.path,
            files=tuple(each.path for each in self._files),
            size_bytes=sum(each.file.size for each in self._files),
            start_ns=start_ns,
            end_ns=end_ns,
            message_count=sum(index.message_count for index in indexes),
            topics=_topics(indexes, (end_ns - start_ns) / 1e9),
            profile=indexes[0].profile,
            library=indexes[0].library,
            metadata={record.name: record.metadata for record in metadata},
            events=tuple(events_in(metadata)),
            indexed=not any(index.scanned for index in indexes),
            missing=tuple(self.missing),
        )

    def metadata(self) -> list[Metadata]:
        """Every metadata record, in the order of the files."""
        return [record for each in self._files for record in each.index.metadata]

    def channels(self) -> dict[tuple[str, str], tuple[Channel, Schema | None]]:
        """Of each topic and type name what the first file says about it."""
        channels: dict[tuple[str, str], tuple[Channel, Schema | None]] = {}
        for each in self._files:
            for channel in each.index.channels.values():
                schema = each.index.schemas.get(channel.schema_id)
                key = channel.topic, schema.name if schema else ""
                channels.setdefault(key, (channel, schema))
        return channels

    def messages(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        window: Window = ALWAYS,
    ) -> Iterator[Message]:
        """The messages in the order of their log time; `on_missing` gets what is found lost.

        Only those with a log time in `window` (ns, both ends included): nothing else is read.
        """
        return merge(self._files, topics, on_missing, window)

    def last_before(
        self, moment_ns: int, wanted: Mapping[str, int], on_missing: Callable[[str], None]
    ) -> list[Message]:
        """Of each topic in `wanted` so many of the last messages before a moment, in order."""
        return last_before(self._files, wanted, moment_ns, on_missing)

    def in_order_written(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> Iterator[Message]:
        """As `messages`, in the order of the files: log times step back where the clock was set.

        `on_progress` gets bytes done and in total.
        """
        return in_order_written(self._files, topics, on_missing, on_progress)

    def _open(self, path: Path, *, only: bool, on_progress: Callable[[int, int], None]) -> None:
        try:
            file = InputFile(path)
        except OSError as error:
            self._give_up(path, error.strerror or repr(error), only=only)
            return
        try:
            index = index_of(file, lambda done: on_progress(done, file.size))
        except Damaged as damage:
            file.close()
            self._give_up(path, str(damage), only=only)
            return
        self._files.append(OpenFile(path, file, index))
        prefix = "" if only else f"{path.name}: "
        for sentence in index.missing:
            note_missing(self.missing, prefix + sentence)

    def _give_up(self, path: Path, reason: str, *, only: bool) -> None:
        note_missing(self.missing, reason if only else f"{path.name}: {reason}")


def recording_files(path: Path) -> list[Path]:
    """The MCAP files of a recording in their order. Raises UnreadableFile if there are none."""
    try:
        mode = path.stat().st_mode
        found = sorted(path.glob("*.mcap"), key=natural_order) if S_ISDIR(mode) else [path]
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise UnreadableFile(f"{path} cannot be read: {reason or error}") from error
    if not (S_ISDIR(mode) or S_ISREG(mode)):
        raise UnreadableFile(f"{path} is no file: give an MCAP file or a recording's folder")
    if not found:
        raise UnreadableFile(f"{path} holds no .mcap file")
    return found


def absent_files(folder: Path, present: list[Path]) -> list[str]:
    """A sentence for each file that the folder's `metadata.yaml` names beside those present."""
    names = {path.name for path in present}
    return [
        f"{name}: metadata.yaml names it, but it is not there"
        for name in rosbag2.named_files(folder)
        if name not in names
    ]


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Sorts `run_10` behind `run_9`."""
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]


def _topics(indexes: list[FileIndex], duration_s: float) -> tuple[TopicInfo, ...]:
    topics: dict[tuple[str, str], TopicInfo] = {}
    for index in indexes:
        for channel in index.channels.values():
            schema = index.schemas.get(channel.schema_id)
            type_name = schema.name if schema else ""
            known = topics.get((channel.topic, type_name))
            count = index.counts.get(channel.id, 0) + (known.message_count if known else 0)
            topics[channel.topic, type_name] = TopicInfo(
                name=channel.topic,
                type_name=type_name,
                message_count=count,
                rate_hz=count / duration_s if duration_s > 0 else 0.0,
                encoding=channel.message_encoding,
                offered_qos=channel.metadata.get(_QOS_KEY, ""),
                type_hash=channel.metadata.get(_HASH_KEY, ""),
                schema_encoding=schema.encoding if schema else "",
                definition=schema.data.decode(errors="replace") if schema else "",
            )
    return tuple(topics[key] for key in sorted(topics))
