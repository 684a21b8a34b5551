"""Opens any MCAP recording: one file, or a folder in rosbag2's layout.

A file without a valid summary is scanned. Parts that cannot be read are always reported: in
`RecordingInfo.missing`, to `on_missing`, or by UnreadableFile at the end of an iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from heapq import heapify, heappop, heappush
from itertools import chain
from pathlib import Path
from typing import Self

from mcap.records import Channel, Metadata, Schema

from robotctl.base.errors import UnreadableFile
from robotctl.recording.format.names import CLIP_RECORD, LEDGER_RECORD
from robotctl.recording.format.records import type_name_of
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.files import (
    absent_files,
    absent_names,
    metadata_of_folder,
    reason_of,
    recording_files,
)
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.info import RecordingInfo, describe, metadata_in
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.messages import (
    ALWAYS,
    Message,
    OpenFile,
    PlaceReader,
    Window,
    find_shortfalls,
    place_readers,
)
from robotctl.recording.read.read_limits import ReadLimits
from robotctl.recording.read.source import Source

_Placed = tuple[int, int, int, Message]
"""Log time, rank of the place, number in the place, and the message, sorted as in `merge`."""


def last_before(
    files: Sequence[OpenFile],
    wanted: Mapping[str, int],
    moment_ns: int,
    on_missing: Callable[[str], None],
) -> list[Message]:
    """Return the last `wanted[topic]` messages of each topic before `moment_ns`, in log order.

    Only places that may hold them are read. `on_missing` gets a sentence about each lost part.
    """
    found = list(enumerate(place_readers(files, wanted, (0, moment_ns - 1))))
    found.sort(key=lambda ranked: ranked[1].place.end_ns, reverse=True)
    held: dict[str, list[_Placed]] = {topic: [] for topic in wanted}
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
            placed: dict[str, list[_Placed]] = {topic: [] for topic in unsettled}
            for number, message in enumerate(_messages(source, on_missing)):
                if message.topic in placed:
                    placed[message.topic].append((message.log_ns, rank, number, message))
            for topic, mine in placed.items():
                held[topic] = sorted(mine + held[topic])[-wanted[topic] :]
    return [each[-1] for each in sorted(each for topic in held.values() for each in topic)]


def _messages(source: PlaceReader, on_missing: Callable[[str], None]) -> list[Message]:
    try:
        source.load()
    except Damaged as damage:
        on_missing(source.loss(damage))
    messages = []
    while source.next < len(source.entries):
        try:
            messages.append(source.take())
        except Damaged as damage:
            on_missing(source.loss(damage))
    source.unload()
    return messages


_AFTER_ALL = (1 << 64, 0)


def merge(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
    window: Window = ALWAYS,
) -> Iterator[Message]:
    """Yield the messages of `topics` (None: all) in the window, in the order of their log time.

    Places outside of the window are not read. `on_missing` gets a sentence about each lost part.
    """
    found = list(place_readers(files, topics, window))
    heap = [(source.place.start_ns, rank) for rank, source in enumerate(found)]
    heapify(heap)
    held = 0
    most = max((file.file.limits.open_bytes for file in files), default=0)
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
    _tell_unaccounted(files, on_missing)


def in_order_written(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[list[Message]]:
    """Yield messages as `merge` does, but in file order and in lists.

    `on_progress` gets the bytes done and in total.
    """
    done, total = 0, sum(file.file.size for file in files)
    for file in files:
        for source in place_readers([file], topics, ALWAYS):
            try:
                yield from source.as_written()
            except Damaged as damage:
                on_missing(source.loss(damage))
            on_progress(done + source.place.offset + source.place.length, total)
        done += file.file.size
        on_progress(done, total)
    _tell_unaccounted(files, on_missing)


def _tell_unaccounted(files: Sequence[OpenFile], on_missing: Callable[[str], None]) -> None:
    """Report files whose summary counts another number of messages than were read."""
    for file in files:
        sentence = file.index.unaccounted()
        if sentence:
            on_missing(f"{file.path.name}: {sentence}")


def _load(source: PlaceReader, room: int | None, on_missing: Callable[[str], None]) -> None:
    """Load a place if it fits into `room` [bytes]; None means no limit."""
    try:
        if room is not None and source.place.size_in_memory(source.file.file) > room:
            source.loaded = True
            raise BeyondLimit("too many chunks overlap in time")
        source.load()
    except Damaged as damage:
        on_missing(source.loss(damage))


def read_info(path: Path) -> RecordingInfo:
    """Return what `path`, a file or a folder, holds.

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
    """Yield the messages in the order of their log time; only those of `topics`, if given.

    `on_missing` gets a sentence about each part that cannot be read.

    Raises:
        UnreadableFile: Nothing can be read; or, without `on_missing`, not everything. Then it is
            raised after the last message that can be read.
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
        """Open `path`; `on_progress` gets bytes done and in total while files are scanned.

        With `source`, one MCAP file is read from it, and `path` is only its name. With `files`,
        only those of the folder `path` are read.

        Raises:
            UnreadableFile: Nothing can be read.
        """
        self.path = path
        self._source = source
        self._files: list[OpenFile] = []
        self.missing: list[str] = []
        self.lost_files: list[str] = []
        """The names of the files that are missing or cannot be read."""

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
        """The read limits that follow from the size of the recording."""
        return ReadLimits.of(sum(each.file.stored_bytes for each in self._files))

    def info(self) -> RecordingInfo:
        """Return what the recording holds."""
        return describe(self.path, self._files, self.missing)

    @property
    def is_live(self) -> bool:
        """Whether a process is still writing the last file."""
        return self._files[-1].file.is_changing()

    @property
    def is_cut_off(self) -> bool:
        """Whether recording ended without closing: the process was killed, or writing failed."""
        return not self.is_live and not self._files[-1].index.has_metadata(
            LEDGER_RECORD, CLIP_RECORD
        )

    @property
    def open_files(self) -> Sequence[OpenFile]:
        """The files of the recording, in the order in which places are numbered."""
        return self._files

    def metadata(self) -> list[Metadata]:
        """Return all metadata records, in the order of the files."""
        return metadata_in(self._files)

    def metadata_of_file(self, number: int) -> dict[str, dict[str, str]]:
        """Return the last metadata record of each name in one file: 0 is the first, -1 the last."""
        return {record.name: record.metadata for record in metadata_in([self._files[number]])}

    def channels(self) -> dict[tuple[str, str], tuple[Channel, Schema | None]]:
        """Return channel and schema by topic and type, from the first file that has them."""
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
        """Yield the messages in log order; `on_missing` gets a sentence about each lost part.

        Only log times in `window` (ns, both ends included) are read.
        """
        return merge(self._files, topics, on_missing, window)

    def last_before(
        self, moment_ns: int, wanted: Mapping[str, int], on_missing: Callable[[str], None]
    ) -> list[Message]:
        """Return the last `wanted[topic]` messages of each topic before a moment, in log order."""
        return last_before(self._files, wanted, moment_ns, on_missing)

    def in_order_written(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> Iterator[Message]:
        """Yield the messages in file order: log times step back if the clock was set back.

        `on_progress` gets bytes done and in total.
        """
        blocks = in_order_written(self._files, topics, on_missing, on_progress)
        return chain.from_iterable(blocks)

    def _open(self, path: Path, *, only: bool, on_progress: Callable[[int, int], None]) -> None:
        try:
            file = InputFile(path, on_progress, self._source)
        except OSError as error:
            self._give_up(path, reason_of(error), only=only)
            return
        except Damaged as damage:
            self._give_up(path, str(damage), only=only)
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
        self.lost_files.append(path.name)
        note_missing(self.missing, reason if only else f"{path.name}: {reason}")
