"""Open any MCAP recording: one file, or a folder in rosbag2's layout."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import chain
from pathlib import Path
from typing import Self

from mcap.records import Channel, Metadata, Schema

from robotctl.base.errors import UnreadableFile
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.names import CLIP_RECORD, LEDGER_RECORD
from robotctl.recording.format.recorded_events import RecordedEvent, events_in
from robotctl.recording.format.records import type_name_of
from robotctl.recording.read.file_index import FileIndex, note_missing
from robotctl.recording.read.files import (
    Source,
    absent_files,
    absent_names,
    metadata_of_folder,
    reason_of,
    recording_files,
)
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.messages import (
    ALWAYS,
    Message,
    OpenFile,
    PlaceReader,
    Window,
    find_shortfalls,
    place_readers,
)
from robotctl.recording.read.read_limits import BeyondLimit, Damaged, ReadLimits
from robotctl.recording.read.records import InputFile

_QOS_KEY = "offered_qos_profiles"
_HASH_KEY = "topic_type_hash"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic in a recording. `rate_hz` is the mean over the whole recording."""

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
    """The summary of a recording. Times are in ns since the epoch, or 0 without messages.

    `missing` has a sentence per unreadable part. `indexed` is False if a file has no valid summary.
    `metadata` has the last record of each name.
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
        return (self.end_ns - self.start_ns) / NS_PER_S


def _topics(indexes: list[FileIndex], duration_s: float) -> tuple[TopicInfo, ...]:
    topics: dict[tuple[str, str], TopicInfo] = {}
    for index in indexes:
        definitions = {  # decoded once, since channels may share them
            schema.id: schema.data.decode(errors="replace") for schema in index.schemas.values()
        }
        for channel in index.channels.values():
            schema = index.schemas.get(channel.schema_id)
            type_name = type_name_of(channel, schema)
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
                definition=definitions.get(channel.schema_id, ""),
            )
    return tuple(topics[key] for key in sorted(topics))


def read_info(path: Path) -> RecordingInfo:
    """Return the `RecordingInfo` of `path`, a file or a folder.

    Raises:
        UnreadableFile: Nothing can be read.
    """
    with Recording(path) as recording:
        return recording.info()


def read_messages(
    path: Path,
    topics: Collection[str] | None = None,
    on_missing: Callable[[str], None] | None = None,
) -> Iterator[Message]:
    """Yield the messages of `topics`, or of all for None, in the order of log time.

    Raises:
        UnreadableFile: Nothing can be read or, without `on_missing`, a part cannot be read.
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
        self,
        path: Path,
        on_progress: Callable[[int, int], None] = lambda done, total: None,
        source: Source | None = None,
        files: Sequence[Path] = (),
    ) -> None:
        """Open the recording `path`, or only `files` of the folder `path`.

        With `source`, one MCAP file is read from it, and `path` is only its name. `on_progress`
        gets bytes done and in total while files are scanned.

        Raises:
            UnreadableFile: Nothing can be read.
        """
        self.path = path
        self._source = source
        self._files: list[OpenFile] = []
        self.missing: list[str] = []
        self.lost_files: list[str] = []
        """The names of the missing and unreadable files."""

        text, problems = ("", []) if source else metadata_of_folder(path)
        paths = [path] if source else list(files) or recording_files(path)
        all_files = False
        if paths != [path]:
            self.lost_files = absent_names(text, paths)
            all_files = not self.lost_files
            for sentence in problems + absent_files(text, paths):
                note_missing(self.missing, sentence)
        try:
            for each in paths:
                self._open(each, only=paths == [path], on_progress=on_progress)
        except BaseException:
            self.close()
            raise
        if not self._files:
            raise UnreadableFile(f"{path} cannot be read: {'; '.join(self.missing)}")
        shortfalls = [*find_shortfalls(text, self._files, all_files=all_files)]
        for sentence in shortfalls:
            note_missing(self.missing, sentence)
        self.lacks_parts = bool(shortfalls) or any(each.index.missing for each in self._files)
        """Whether parts of the readable files are missing."""

    def close(self) -> None:
        """Close the files."""
        for each in self._files:
            each.file.close()

    def __enter__(self) -> Self:
        """Return the recording."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording."""
        self.close()

    @property
    def limits(self) -> ReadLimits:
        """The read limits for the size of the recording."""
        return ReadLimits.of(sum(each.file.stored_bytes for each in self._files))

    def info(self) -> RecordingInfo:
        """Return the summary of the recording."""
        indexes = [each.index for each in self._files]
        metadata = self.metadata()
        with_messages = [index for index in indexes if index.message_count]
        start_ns = min((index.start_ns for index in with_messages), default=0)
        end_ns = max((index.end_ns for index in with_messages), default=0)
        return RecordingInfo(
            path=self.path,
            files=tuple(each.path for each in self._files),
            size_bytes=sum(each.file.size for each in self._files),
            start_ns=start_ns,
            end_ns=end_ns,
            message_count=sum(index.message_count for index in indexes),
            topics=_topics(indexes, (end_ns - start_ns) / NS_PER_S),
            profile=indexes[0].header.profile,
            library=indexes[0].header.library,
            metadata={record.name: record.metadata for record in metadata},
            events=tuple(events_in(metadata)),
            indexed=not any(index.scanned for index in indexes),
            missing=tuple(self.missing),
        )

    @property
    def is_live(self) -> bool:
        """Whether a process is still writing the last file."""
        return self._files[-1].file.is_changing()

    @property
    def is_cut_off(self) -> bool:
        """Whether recording ended without closing. Also True for files of other programs."""
        return not self.is_live and not self._files[-1].index.has_metadata(
            LEDGER_RECORD, CLIP_RECORD
        )

    @property
    def open_files(self) -> Sequence[OpenFile]:
        """The readable files of the recording, in their order."""
        return self._files

    def metadata(self) -> list[Metadata]:
        """Return all metadata records, in the order of the files."""
        return [record for each in self._files for record in each.index.metadata]

    def metadata_of_file(self, number: int) -> dict[str, dict[str, str]]:
        """Return the last metadata record of each name in file `number` (0: first, -1: last)."""
        return {record.name: record.metadata for record in self._files[number].index.metadata}

    def channels(self) -> dict[tuple[str, str], tuple[Channel, Schema | None]]:
        """Return (channel, schema) by (topic, type), from the first file with such a topic."""
        channels: dict[tuple[str, str], tuple[Channel, Schema | None]] = {}
        for each in self._files:
            for channel in each.index.channels.values():
                schema = each.index.schemas.get(channel.schema_id)
                key = channel.topic, type_name_of(channel, schema)
                channels.setdefault(key, (channel, schema))
        return channels

    def messages(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        window: Window = ALWAYS,
    ) -> Iterator[Message]:
        """Yield the messages of `topics` (None: all) in `window`, in the order of log time.

        `on_missing` gets a sentence about each lost part.
        """
        found = list(place_readers(self._files, topics, window))
        heap = [(source.place.start_ns, rank) for rank, source in enumerate(found)]
        heapify(heap)
        held = 0
        most = max(each.file.limits.open_bytes for each in self._files)
        while heap:
            _, rank = heappop(heap)
            source = found[rank]
            if not source.loaded:
                _load(source, most - held if held else None, on_missing)
                held += source.size
            entries = source.entries
            ahead = heap[0] if heap else _AFTER_ALL
            while source.next < len(entries) and (entries[source.next][0], rank) < ahead:
                try:
                    message = source.take()
                except Damaged as damage:
                    on_missing(source.loss(damage))
                    continue
                yield message
            if source.next < len(entries):
                heappush(heap, (entries[source.next][0], rank))
            else:
                held -= source.size
                source.unload()
        self._report_unaccounted(on_missing)

    def in_order_written(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> Iterator[Message]:
        """Yield the messages of `topics` (None: all) in file order.

        `on_missing` gets a sentence about each lost part, `on_progress` the bytes done and in
        total.
        """
        done, total = 0, sum(each.file.size for each in self._files)
        for each in self._files:
            for source in place_readers([each], topics, ALWAYS):
                for messages in _as_written(source, on_missing):
                    yield from messages
                on_progress(done + source.place.offset + source.place.length, total)
            done += each.file.size
            on_progress(done, total)
        self._report_unaccounted(on_missing)

    def last_before(
        self, moment_ns: int, wanted: Mapping[str, int], on_missing: Callable[[str], None]
    ) -> list[Message]:
        """Return the last messages before `moment_ns`, `wanted[topic]` per topic, by log time."""
        found = list(enumerate(place_readers(self._files, wanted, (0, moment_ns - 1))))
        found.sort(key=lambda ranked: ranked[1].place.end_ns, reverse=True)
        held: dict[str, list[tuple[int, int, int, Message]]] = {topic: [] for topic in wanted}
        for rank, source in found:
            end_ns = source.place.end_ns
            unsettled = {
                topic
                for topic, count in wanted.items()
                if len(held[topic]) < count or held[topic][0][0] <= end_ns
            }
            if not unsettled:
                break
            if source.may_hold(unsettled):
                for number, message in enumerate(
                    chain.from_iterable(_as_written(source, on_missing))
                ):
                    if message.topic in unsettled and message.log_ns < moment_ns:
                        held[message.topic].append((message.log_ns, rank, number, message))
                for topic in unsettled:
                    held[topic] = sorted(held[topic])[-wanted[topic] :]
        return [each[-1] for each in sorted(each for topic in held.values() for each in topic)]

    def _report_unaccounted(self, on_missing: Callable[[str], None]) -> None:
        """Report each file whose summary counts more or fewer messages than were read."""
        for each in self._files:
            if sentence := each.index.unaccounted():
                on_missing(f"{each.path.name}: {sentence}")

    def _open(self, path: Path, *, only: bool, on_progress: Callable[[int, int], None]) -> None:
        try:
            file = InputFile(path, on_progress, self._source)
            try:
                index = index_of(file, lambda done: on_progress(done, file.size))
            except BaseException:
                file.close()
                raise
        except (OSError, Damaged) as error:
            reason = reason_of(error) if isinstance(error, OSError) else str(error)
            self.lost_files.append(path.name)
            note_missing(self.missing, reason if only else f"{path.name}: {reason}")
            return
        self._files.append(OpenFile(path, file, index))
        prefix = "" if only else f"{path.name}: "
        for sentence in index.missing:
            note_missing(self.missing, prefix + sentence)


_AFTER_ALL = (1 << 64, 0)


def _load(source: PlaceReader, room: int | None, on_missing: Callable[[str], None]) -> None:
    """Load a place, or report it if it needs more than `room` [bytes]; None means no limit."""
    try:
        if room is not None and source.place.size_in_memory(source.file.file) > room:
            source.loaded = True
            raise BeyondLimit("too many chunks overlap in time")
        source.load()
    except Damaged as damage:
        on_missing(source.loss(damage))


def _as_written(source: PlaceReader, on_missing: Callable[[str], None]) -> Iterator[list[Message]]:
    try:
        yield from source.as_written()
    except Damaged as damage:
        on_missing(source.loss(damage))
