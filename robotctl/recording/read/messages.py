"""Read the messages of a file, and compare their number with the recorded counts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from robotctl.recording.format.names import CLIP_RECORD, LEDGER_RECORD, RECOVERY_RECORD
from robotctl.recording.format.records import PlainMessage, type_name_of
from robotctl.recording.format.rosbag2 import message_counts_in, total_count_in
from robotctl.recording.format.topics import read_ledger
from robotctl.recording.read.chunks import MessageDecompressor
from robotctl.recording.read.file_index import FileIndex, Place, PlaceKind, note_missing
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.read_limits import BeyondLimit, Damaged
from robotctl.recording.read.records import (
    MESSAGE_FIELDS,
    RECORD_HEAD,
    TOO_MANY_RECORDS,
    HeadBlock,
    InputFile,
    RecordHead,
    head_blocks,
    read_attachment,
)

Window = tuple[int, int]
"""First and last log time [ns], both included."""

ALWAYS: Final[Window] = (0, (1 << 64) - 1)


_HEAD_BYTES: Final = RECORD_HEAD.size + MESSAGE_FIELDS.size

_new: Final = tuple.__new__
"""Creates a named tuple in a third of the time that a call of its class takes."""


class Message(NamedTuple):
    """One recorded message. Times are since the epoch, and `data` is serialized as received."""

    topic: str
    type_name: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(frozen=True, slots=True)
class OpenFile:
    """An open file of a recording."""

    path: Path
    file: InputFile
    index: FileIndex


class PlaceReader:
    """Reads one `Place`, such as a chunk. `names` has topic and type by id of the wanted channels.

    After `load`, `take` returns the messages in `window`, by log time. `contents` and `as_written`
    yield those of any time, in file order.
    """

    def __init__(
        self, file: OpenFile, place: Place, names: dict[int, tuple[str, str]], window: Window
    ) -> None:
        self.file = file
        self.window = window
        self.place = place
        self.entries: list[tuple[int, int, int]] = []  # log time, position, length of the content
        self.next = 0
        self.loaded = False
        self.size = 0
        self._names = names
        self._data = b""
        self._decompressor: MessageDecompressor | None = None
        if file.index.message_compression:
            limits, unpacked = file.file.limits, file.index.unpacked
            self._decompressor = MessageDecompressor(place.offset, limits, unpacked)

    def may_hold(self, topics: Collection[str]) -> bool:
        """Return whether this part of the file may have messages of `topics`. False is certain."""
        channels = self.place.channels
        return channels is None or any(
            topic in topics for channel, (topic, _) in self._names.items() if channel in channels
        )

    def load(self) -> None:
        """Read the place. `entries` then lists the wanted messages within `window`, by log time.

        Raises:
            Damaged: A part is damaged; `entries` has the messages before it.
        """
        self.loaded = True
        data = self._data = self._read()
        self.size = len(data)
        first_ns, last_ns = self.window
        try:
            for wanted in self._wanted(data):
                self.entries += [
                    (log_ns, position, length)
                    for position, (_, length, _, _, log_ns, _) in wanted
                    if first_ns <= log_ns <= last_ns
                ]
        finally:
            self.entries.sort()

    def take(self) -> Message:
        """Return the next message of `entries`. There must be one.

        Raises:
            Damaged: The message cannot be decompressed; the next call returns the one after it.
        """
        _, position, length = self.entries[self.next]
        self.next += 1
        begin = position + RECORD_HEAD.size
        channel, sequence, log_ns, publish_ns = MESSAGE_FIELDS.unpack_from(self._data, begin)
        content = self._data[position + _HEAD_BYTES : begin + length]
        if self._decompressor is not None:
            content = self._decompressor.decompress(content)
        return Message(*self._names[channel], content, log_ns, publish_ns, sequence)

    def contents(self) -> Iterator[list[tuple[RecordHead, bytes]]]:
        """Yield lists of (record head, data) of all messages of the wanted channels, in file order.

        Raises:
            Damaged: Messages are missing. It is raised after the last readable one.
        """
        failure: Damaged | None = None
        data, begin = self._read(), RECORD_HEAD.size
        for wanted in self._wanted(data):
            contents = [
                (head, data[position + _HEAD_BYTES : position + begin + head[1]])
                for position, head in wanted
            ]
            if self._decompressor is None:
                yield contents
                continue
            for head, packed in contents:
                try:
                    content = self._decompressor.decompress(packed)
                except Damaged as damage:
                    failure = damage
                    continue
                yield [(head, content)]
        if failure is not None:
            raise failure

    def as_written(self) -> Iterator[list[Message]]:
        """Yield lists of all messages of the wanted channels, in file order.

        Raises:
            Damaged: Messages are missing. It is raised after the last readable one.
        """
        names = self._names
        for contents in self.contents():
            yield [
                _new(Message, names[channel] + (content, log_ns, publish_ns, sequence))
                for (_, _, channel, sequence, log_ns, publish_ns), content in contents
            ]

    def _read(self) -> bytes:
        """Return the records of the place, decompressed.

        Raises:
            Damaged: They cannot be read, or exceed the limits.
        """
        if self._records_left() <= 0:
            raise BeyondLimit(TOO_MANY_RECORDS)
        return self.place.read(self.file.file)

    def _records_left(self) -> int:
        file = self.file
        return file.file.limits.records - file.index.records.others(self.place.offset)

    def _wanted(self, data: bytes) -> Iterator[HeadBlock]:
        """Yield lists of (position, record head) of the messages of the wanted channels.

        Raises:
            Damaged: The place is damaged. It is raised after the last readable message.
        """
        records = others = unknown = 0
        offset, index = self.place.offset, self.file.index
        names, known, message = self._names, index.channels, Opcode.MESSAGE.value
        try:
            for block in head_blocks(data, self._records_left()):
                records += len(block)
                wanted = [
                    each for each in block if (head := each[1])[0] == message and head[2] in names
                ]
                for _, head in block if len(wanted) < len(block) else ():
                    if head[0] != message:
                        others += 1
                    elif head[2] not in known:
                        unknown += 1
                yield wanted
            index.messages_read[offset] = records - others
        except Damaged as damage:
            # The index has already reported that the end of this chunk is missing.
            if self.place.kind is not PlaceKind.TORN_CHUNK or isinstance(damage, BeyondLimit):
                raise
        finally:
            index.records.note(offset, records)
        if unknown and not index.scanned:  # else already reported
            raise Damaged(f"{unknown} messages belong to no channel")

    def loss(self, damage: Damaged) -> str:
        """Return a sentence about the messages that `damage` destroyed: file, bytes, reason."""
        begin = self.place.offset
        return (
            f"{self.file.path.name}: messages between bytes {begin} and "
            f"{begin + self.place.length} are lost: {damage}"
        )

    def unload(self) -> None:
        """Free the memory of the messages."""
        self._data = b""
        self.entries = []


def place_readers(
    files: Iterable[OpenFile], topics: Collection[str] | None, window: Window
) -> Iterator[PlaceReader]:
    """Yield a reader for each place in `window` that may hold messages of `topics` (None: all)."""
    for file in files:
        names = names_of(file.index, topics)
        for place in file.index.places:
            in_time = place.start_ns <= window[1] and place.end_ns >= window[0]
            if in_time and (place.channels is None or not place.channels.isdisjoint(names)):
                yield PlaceReader(file, place, names, window)


def names_of(index: FileIndex, topics: Collection[str] | None = None) -> dict[int, tuple[str, str]]:
    """Return (topic, type) by channel id, for the given `topics` or, if None, for all."""
    return {
        channel.id: (channel.topic, type_name_of(channel, index.schemas.get(channel.schema_id)))
        for channel in index.channels.values()
        if topics is None or channel.topic in topics
    }


_BATCH_BYTES: Final = 8 << 20
"""Size of the messages in a chunk of a copy. Original chunks may be larger."""


class ReadableFile:
    """Reader of all records of a file in file order, for a copy of the file.

    `lost` has a sentence for each loss. `on_progress` gets the reached offset [bytes].
    """

    def __init__(self, opened: OpenFile, on_progress: Callable[[int], None]) -> None:
        self.file, self.index = opened.file, opened.index
        self.name = opened.path.name
        self.profile, self.library = self.index.header.profile, self.index.header.library
        self.lost = list(self.index.missing)
        self._opened = opened
        self._names = names_of(self.index)
        self._on_progress = on_progress

    def channels(self) -> Sequence[tuple[Channel, Schema | None]]:
        """Return pairs of channel and schema, with None for a missing schema."""
        schemas, channels = self.index.schemas, self.index.channels.values()
        return [(each, schemas.get(each.schema_id)) for each in channels]

    def metadata(self) -> Sequence[Metadata]:
        """Return the metadata records in their order."""
        return self.index.metadata

    def batches(self) -> Iterator[list[PlainMessage]]:
        """Yield all messages in lists, each from one chunk or a part of a large chunk."""
        for place in self.index.places:
            yield from batched(self._messages(place), _BATCH_BYTES)
            self._on_progress(place.offset)
        if sentence := self.index.unaccounted():
            note_missing(self.lost, sentence)

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments, one at a time in memory."""
        behind = 0
        for offset in sorted(self.index.attachments):
            try:
                if offset < behind:
                    raise Damaged("it overlaps another attachment")
                behind = self.file.record(offset).end
                yield read_attachment(self.file, offset)
            except Damaged as damage:
                self._lose(f"the attachment at byte {offset} is lost", damage)

    def _lose(self, what: str, damage: Damaged) -> None:
        self.index.limit_reached |= isinstance(damage, BeyondLimit)
        note_missing(self.lost, f"{what}: {damage}")

    def _messages(self, place: Place) -> Iterator[PlainMessage]:
        try:
            for contents in PlaceReader(self._opened, place, self._names, ALWAYS).contents():
                for (_, _, channel, sequence, log_ns, publish_ns), data in contents:
                    yield channel, data, log_ns, publish_ns, sequence
        except Damaged as damage:
            self._lose(f"bytes {place.offset} to {place.offset + place.length} are lost", damage)


def batched(messages: Iterable[PlainMessage], most_bytes: int) -> Iterator[list[PlainMessage]]:
    """Yield the messages in lists. A list ends once its data has `most_bytes` or more."""
    batch: list[PlainMessage] = []
    size = 0
    for message in messages:
        batch.append(message)
        size += len(message[1])
        if size >= most_bytes:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch


@contextmanager
def open_readable(
    path: Path, text: str, on_progress: Callable[[int, int], None]
) -> Iterator[ReadableFile]:
    """Open a file to copy it. `text` is the content of the recording's `metadata.yaml`, or "".

    `on_progress` gets bytes done and in total. A byte counts twice: when indexed, when copied.

    Raises:
        OSError: The file cannot be opened.
        Damaged: Nothing in the file can be read.
    """
    with InputFile(path, on_progress) as file:
        size, total = file.size, 2 * file.size
        opened = OpenFile(path, file, index_of(file, lambda done: on_progress(done, total)))
        for sentence in find_shortfalls(text, [opened], all_files=False):
            opened.index.miss(sentence)
        yield ReadableFile(opened, lambda done: on_progress(size + done, total))


def find_shortfalls(text: str, files: Sequence[OpenFile], *, all_files: bool) -> Iterator[str]:
    """Yield a sentence for each count of the recorder that exceeds the messages found in `files`.

    `text`, the content of `metadata.yaml`, must be read before the files. `all_files` tells whether
    `files` are the whole recording.
    """
    if any(each.index.limit_reached for each in files):
        return  # not all messages were read
    told, there = message_counts_in(text), sum(each.index.message_count for each in files)
    found = [
        f"{each.path.name}: metadata.yaml counts {told[each.path.name]} messages, "
        f"and {each.index.message_count} are there"
        for each in files
        if each.index.own and told.get(each.path.name, 0) > each.index.message_count
    ]
    # The counts per file of rosbag2 include messages that its cache dropped; the total does not.
    total = total_count_in(text)
    if not found and all_files and total > there:
        found.append(f"metadata.yaml counts {total} messages, and {there} are there")
    if not found and _is_whole(files):
        written = _written_by_ledger(files[-1])
        if written > there:
            found.append(f"its ledger counts {written} messages, and {there} are there")
    yield from found


def _is_whole(files: Sequence[OpenFile]) -> bool:
    """Return whether `files` are the first of a recording, without gap, clip or repair."""
    first = files[0].path.stem
    names = [f"{first.removesuffix('0')}{number}" for number in range(len(files))]
    return (
        first.endswith("_0")
        and [each.path.stem for each in files] == names
        and not any(each.index.has_metadata(CLIP_RECORD, RECOVERY_RECORD) for each in files)
    )


def _written_by_ledger(last: OpenFile) -> int:
    """Return the number of messages that the ledger of the last file counts, 0 without a ledger."""
    records = [each.metadata for each in last.index.metadata if each.name == LEDGER_RECORD]
    ledger = read_ledger({LEDGER_RECORD: records[-1]} if records else {})
    return sum(counts.get("written", 0) for counts in ledger.values())
