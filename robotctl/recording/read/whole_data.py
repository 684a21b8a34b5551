"""Read every byte of a file's data section and summary, and check that the records agree.

In files of robotctl, each record must have exactly the bytes that robotctl writes.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf
from typing import Any, Final

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from robotctl.recording.format.names import (
    CLIP_RECORD,
    CONVERSION_RECORD,
    LEDGER_RECORD,
    RECOVERY_RECORD,
)
from robotctl.recording.format.records import (
    FIRST_PRIVATE_OPCODE,
    MAGIC,
    ROOM_OPCODE,
    Chunk,
    place,
    record_bytes,
)
from robotctl.recording.format.seal_records import LINK_OPCODE, OPENING_OPCODE
from robotctl.recording.read.chunks import ChunkHead, read_chunk, read_chunk_head
from robotctl.recording.read.file_index import Contents, FileIndex
from robotctl.recording.read.read_limits import BeyondLimit, Damaged, UnpackBudget
from robotctl.recording.read.records import (
    LOST_HEADER,
    MESSAGE_FIELDS,
    RECORD_HEAD,
    TOO_MANY_RECORDS,
    ZEROS,
    InputFile,
    Record,
    parse,
    read_attachment,
    read_header,
    walk_records,
)

MAX_FLAWS: Final = 20
"""Maximum number of kept flaws of a file. Further flaws are only counted."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """Wrong bytes of a file, from `start` to before `end`. `text` does not name the place."""

    start: int
    end: int
    text: str

    def sentence(self) -> str:
        """Return place and text as one sentence."""
        return f"bytes {self.start} to {self.end}: {self.text}"


@dataclass(slots=True)
class Flaws:
    """The first flaws of one file in file order, and the number of all flaws."""

    kept: list[Flaw] = field(default_factory=list)
    count: int = 0

    def add(self, start: int, end: int, text: str) -> None:
        """Count a flaw, and keep it if fewer than MAX_FLAWS are kept."""
        self.count += 1
        if len(self.kept) < MAX_FLAWS:
            self.kept.append(Flaw(start, end, text))


class FileState(StrEnum):
    """Whether a file is complete, and what wrote it."""

    FINISHED = "finished"
    LIVE = "live"
    """A process is still writing the file."""

    NOT_CLOSED = "not closed"
    """The recorder was killed, or could not write."""

    REPAIRED = "repaired"
    """robotctl wrote the file, or only its end, again after a kill."""

    CONVERTED = "converted"
    """robotctl wrote the file from another recording."""

    CLIP = "clip"
    FOREIGN = "of another program"


_STATES: Final = {
    CLIP_RECORD: FileState.CLIP,
    RECOVERY_RECORD: FileState.REPAIRED,
    CONVERSION_RECORD: FileState.CONVERTED,
    LEDGER_RECORD: FileState.FINISHED,
}
"""The state of a robotctl file by a metadata record in it. The first match counts."""


@dataclass(slots=True)
class WholeData(FileIndex):
    """What was read of a file's data section.

    `end` is the offset of the DataEnd record, or where the reading had to stop. `crc` is the
    computed checksum of the bytes before `end`. `told_crc` is the stored one: 0 if the writer
    stored none, None without a DataEnd record.
    """

    end: int = 0
    crc: int = 0
    told_crc: int | None = None
    listed: dict[int, dict[int, Any]] = field(
        default_factory=lambda: {opcode: {} for opcode in _LISTED}
    )
    """The records that the summary must have, by opcode, and by id (schema, channel) or offset."""

    bad_chunks: set[int] = field(default_factory=set)
    """Offsets of the unreadable chunks."""

    private: list[Record] = field(default_factory=list)
    private_in_summary: list[tuple[int, bytes]] = field(default_factory=list)
    """Opcode and content of each private record of the summary."""

    unread: str = ""
    """A sentence about what was not read, "" if everything was read."""

    before_last_chunk: tuple[dict[int, int], int, int] = field(default_factory=lambda: ({}, 0, 0))
    """The values of `counts`, `start_ns` and `end_ns` without the last chunk."""

    unfinished: int | None = None
    """The offset of an unfinished commit, which reaches to the end of the data."""

    def state(self) -> FileState:
        """Return the state of the file. Do not call this while the file is growing."""
        if not self.own:
            return FileState.FOREIGN
        for name, state in _STATES.items():
            if self.has_metadata(name):
                return state
        return FileState.NOT_CLOSED

    def statistics(self) -> Statistics:
        """Return the statistics record that the summary must have, counted from the data."""
        return Statistics(
            attachment_count=len(self.listed[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.listed[Opcode.CHUNK_INDEX]),
            message_count=self.message_count,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self.listed[Opcode.METADATA_INDEX]),
            schema_count=len(self.schemas),
        )


def read_data_section(
    file: InputFile,
    flaws: Flaws,
    stop: float = inf,
    on_progress: Callable[[int], None] = lambda offset: None,
) -> WholeData:
    """Read the data section up to its DataEnd record or `stop`, and add faults to `flaws`.

    Raises:
        Damaged: The file does not begin as an MCAP file, or the disk fails.
    """
    header, offset = read_header(file)
    if header is LOST_HEADER:
        raise Damaged(ZEROS)
    data = WholeData(header)
    if data.own and record_bytes(header) != file.read(len(MAGIC), offset - len(MAGIC)):
        flaws.add(len(MAGIC), offset, "the header is not as robotctl writes it")
    walk = _Walk(file, data, flaws)
    while offset < stop:
        end = None
        try:
            end = walk.record(offset)
        except BeyondLimit as limit:
            data.unread = f"the data after byte {offset} is not read: {limit}"
        except Damaged as damage:
            if file.failure:
                raise file.failure from None
            flaws.add(offset, min(offset + RECORD_HEAD.size, file.size), str(damage))
            data.unread = f"the data after byte {offset} is not read"
        if end is None:
            break
        on_progress(offset)
        offset = end
        if offset - data.end > _PIECE_BYTES:
            _add_to_crc(data, file, offset)
    _add_to_crc(data, file, offset)
    return data


_PIECE_BYTES: Final = 1 << 20


def _add_to_crc(data: WholeData, file: InputFile, end: int) -> None:
    """Continue the CRC up to `end`. The bytes are read again, from the page cache."""
    for piece in file.pieces(data.end, end):
        data.crc = crc32(piece, data.crc)
    data.end = end


class _Walk:
    """One pass over the records of a data section."""

    def __init__(self, file: InputFile, data: WholeData, flaws: Flaws) -> None:
        self._file = file
        self._data = data
        self._flaws = flaws
        self._budget = UnpackBudget(file.limits)
        self._records = 0
        self._entry: ChunkIndex | None = None
        """The last chunk, while its message indexes are read."""

        self._skip = False
        """Whether the last chunk cannot be read."""

        self._expected: dict[int, bytes] = {}
        """The missing message indexes of the last chunk, by channel."""

    def record(self, offset: int) -> int | None:
        """Check the record at `offset`, and return the offset after it, None for DataEnd.

        Raises:
            Damaged: There is no valid record, so what follows cannot be read.
        """
        file, data = self._file, self._data
        record = file.record(offset)
        opcode = record.opcode
        if record.end > file.size:
            raise Damaged(f"a record claims to have {record.length} bytes, more than are left")
        self._records += 1
        if self._records > file.limits.records:
            raise BeyondLimit(TOO_MANY_RECORDS)
        if opcode == Opcode.MESSAGE_INDEX:
            if data.unfinished is None:
                self._message_index(record, file.content(record))
            return record.end
        self._end_chunk(offset)
        if data.unfinished is not None and opcode != Opcode.DATA_END:
            raise Damaged("records follow a commit that was not finished")
        if opcode == Opcode.CHUNK:
            self._chunk(record)
        elif opcode == Opcode.ATTACHMENT:
            self._attachment(record)
        elif opcode == ROOM_OPCODE and data.own:
            data.unfinished = offset
        elif opcode in (OPENING_OPCODE, LINK_OPCODE) or (
            opcode >= FIRST_PRIVATE_OPCODE and not data.own
        ):
            data.private.append(record)
        elif opcode == Opcode.DATA_END:
            data.told_crc = parse(DataEnd, file.content(record)).data_section_crc
            return None
        else:
            self._single(record)
        return record.end

    def _single(self, record: Record) -> None:
        """Check a record outside of chunks.

        Raises:
            Damaged: A data section has no records of this kind, or the disk fails.
        """
        data, opcode = self._data, record.opcode
        is_message = opcode == Opcode.MESSAGE and not data.own
        if not (
            (is_message and record.length >= MESSAGE_FIELDS.size)
            or opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
        ):
            raise Damaged(
                f"no record of kind {opcode} belongs here" if opcode else "they are zeros"
            )
        try:
            content = self._file.content(record)
            if is_message:
                channel, _, log_ns, _ = MESSAGE_FIELDS.unpack_from(content)
                data.count({channel: 1}, log_ns, log_ns)
                return
            read: McapRecord
            if opcode == Opcode.METADATA:
                read = metadata = parse(Metadata, content)
                data.metadata.append(metadata)
                data.listed[Opcode.METADATA_INDEX][record.offset] = MetadataIndex(
                    record.offset, record.end - record.offset, metadata.name
                )
            else:
                read = self._define(opcode, content, record)
            if data.own and record_bytes(read)[RECORD_HEAD.size :] != content:
                self._flaw(record, "a record is not as robotctl writes it")
        except Damaged as damage:
            if self._file.failure:
                raise
            self._flaw(record, str(damage))

    def _flaw(self, record: Record, text: str) -> None:
        self._flaws.add(record.offset, record.end, text)

    def _define(self, opcode: int, content: bytes, record: Record) -> Schema | Channel:
        """Add and return a schema or a channel in `record`, which may be a chunk.

        Raises:
            Damaged: The schema or channel is malformed.
        """
        data = self._data
        found: Schema | Channel
        if opcode == Opcode.SCHEMA:
            found = schema = parse(Schema, content)
            data.schemas.setdefault(schema.id, schema)
        else:
            found = channel = parse(Channel, content)
            if channel.schema_id and channel.schema_id not in data.schemas:
                self._flaw(record, f"channel {channel.id} has a schema that is not there")
            data.channels.setdefault(channel.id, channel)
        if data.listed[opcode].setdefault(found.id, content) != content:
            self._flaw(record, f"it describes {found.id} in another way than an earlier record")
        return found

    def _attachment(self, record: Record) -> None:
        try:
            found = read_attachment(self._file, record.offset)
        except BeyondLimit:
            raise
        except Damaged as damage:
            self._flaw(record, f"an attachment: {damage}")
            return
        self._data.listed[Opcode.ATTACHMENT_INDEX][record.offset] = AttachmentIndex(
            offset=record.offset,
            length=record.end - record.offset,
            log_time=found.log_time,
            create_time=found.create_time,
            data_size=len(found.data),
            name=found.name,
            media_type=found.media_type,
        )

    def _chunk(self, record: Record) -> None:
        """Check a chunk.

        Raises:
            Damaged: The disk or the memory fails.
            BeyondLimit: The chunk has too many records, or is too large.
        """
        file, data, found = self._file, self._data, Contents()
        try:
            head = read_chunk_head(file, record.offset, record.end - record.offset)
            self._budget.spend(head.uncompressed_size)
            found.walk(
                read_chunk(file, head),
                file.limits.records - self._records,
                lambda opcode, content: self._define(opcode, content, record),
                self._check_channel,
            )
        except BeyondLimit:
            raise
        except Damaged as damage:
            if file.failure:
                raise
            self._flaw(record, str(damage))
            self._skip = True
            data.bad_chunks.add(record.offset)
            return
        self._records += found.records
        data.before_last_chunk = dict(data.counts), data.start_ns, data.end_ns
        if found.entries:
            window = found.window()
            if window != (head.start_ns, head.end_ns):
                self._flaw(record, "a chunk holds messages of other times than it says")
            data.count(found.counts, *window)
        self._entry = self._placed(head, record, empty=not found.entries)
        data.listed[Opcode.CHUNK_INDEX][record.offset] = self._entry
        self._expected = {channel: entries.tobytes() for channel, entries in found.entries.items()}

    def _check_channel(self, channel: int) -> None:
        if channel not in self._data.channels:
            raise Damaged(f"a chunk holds messages of channel {channel}, without a topic")

    def _placed(self, head: ChunkHead, record: Record, *, empty: bool) -> ChunkIndex:
        stored = memoryview(self._file.read(head.data_offset, head.data_size))
        times = head.start_ns, head.end_ns
        described = Chunk([stored], head.compression, head.uncompressed_size, head.crc, *times, {})
        placed = place(described, record.offset)
        if self._data.own and (
            empty or not head.crc or placed.head != self._file.read(record.offset, len(placed.head))
        ):
            self._flaw(record, "a chunk is not as robotctl writes it")
        return placed.entry

    def _message_index(self, record: Record, content: bytes) -> None:
        if self._skip:
            return  # their chunk cannot be read
        channel = int.from_bytes(content[:2], "little")
        size = int.from_bytes(content[2:_INDEX_HEAD_BYTES], "little")
        expected = self._expected.pop(channel, None)
        if self._entry is None:
            self._flaw(record, "a message index follows no chunk")
            return
        self._entry.message_index_offsets[channel] = record.offset
        self._entry.message_index_length += record.end - record.offset
        if expected is None:
            # An index of no messages is allowed, though robotctl writes none.
            right = not self._data.own and size == 0
        else:
            entries = content[_INDEX_HEAD_BYTES : _INDEX_HEAD_BYTES + size]
            right = size + _INDEX_HEAD_BYTES == len(content) and (
                entries == expected
                or (not self._data.own and _sorted(entries) == _sorted(expected))
            )
        if not right:
            self._flaw(record, "a message index does not fit the messages of its chunk")

    def _end_chunk(self, offset: int) -> None:
        """Note that the last chunk and its message indexes end at `offset`."""
        entry = self._entry
        lacks = entry and self._expected and (self._data.own or entry.message_index_offsets)
        if entry and lacks:
            self._flaws.add(entry.chunk_start_offset, offset, "a chunk lacks a message index")
        self._expected, self._entry, self._skip = {}, None, False


_INDEX_HEAD_BYTES: Final = 6
"""Channel id and length of the entries, at the beginning of a message index."""


def _sorted(entries: bytes) -> list[tuple[int, int]]:
    """Return the sorted entries of a message index. Other writers may sort them by time."""
    values = array("Q", entries[: len(entries) // 16 * 16])
    return sorted(zip(values[::2], values[1::2], strict=True))


def _key_and_content(content: bytes) -> tuple[int, Any]:
    return int.from_bytes(content[:2], "little"), content


def _key_and_index(kind: Any, key: str) -> Callable[[bytes], tuple[int, Any]]:
    def read(content: bytes) -> tuple[int, Any]:
        told = parse(kind, content)
        return getattr(told, key), told

    return read


_LISTED: Final[dict[int, Callable[[bytes], tuple[int, Any]]]] = {
    Opcode.SCHEMA: _key_and_content,
    Opcode.CHANNEL: _key_and_content,
    Opcode.METADATA_INDEX: _key_and_index(MetadataIndex, "offset"),
    Opcode.ATTACHMENT_INDEX: _key_and_index(AttachmentIndex, "offset"),
    Opcode.CHUNK_INDEX: _key_and_index(ChunkIndex, "chunk_start_offset"),
    Opcode.STATISTICS: lambda content: (0, parse(Statistics, content)),
}
"""Functions that return id or offset, and content, of a summary record."""


def compare_summary(summary: bytes, start: int, data: WholeData, flaws: Flaws) -> None:
    """Add a flaw for each difference between `data` and the summary, which begins at `start`."""
    data.listed[Opcode.STATISTICS] = {0: data.statistics()}
    seen: dict[int, set[int]] = {opcode: set() for opcode in _LISTED}
    groups: dict[int, tuple[int, int]] = {}
    try:
        for opcode, begin, stop in walk_records(summary):
            content = summary[begin:stop]
            place, end = start + begin - RECORD_HEAD.size, start + stop
            if opcode == Opcode.SUMMARY_OFFSET:
                wrong = _wrong_offset(content, groups, data, (start, place))
            else:
                groups[opcode] = groups.get(opcode, (place, end))[0], end
                wrong = _wrong_record(opcode, content, seen, data)
            for sentence in wrong:
                flaws.add(place, end, sentence)
    except Damaged:
        flaws.add(start, start + len(summary), "the summary cannot be read to its end")
        return
    for opcode, there in data.listed.items() if data.own else ():
        if missing := there.keys() - seen[opcode]:
            text = f"the summary lacks the {_name(opcode)} of {min(missing)}"
            flaws.add(start, start + len(summary), text)


def _wrong_record(
    opcode: int, content: bytes, seen: dict[int, set[int]], data: WholeData
) -> Iterator[str]:
    """Yield a sentence for each mistake in one record of the summary."""
    if opcode not in _LISTED:
        if opcode < FIRST_PRIVATE_OPCODE or (data.own and opcode != LINK_OPCODE):
            yield f"no record of kind {opcode} belongs in a summary"
        data.private_in_summary.append((opcode, content))
        return
    try:
        key, told = _LISTED[opcode](content)
    except Damaged as damage:
        yield str(damage)
        return
    if key in seen[opcode]:
        yield f"the summary holds the same {_name(opcode)} twice"
    seen[opcode].add(key)
    if opcode == Opcode.CHUNK_INDEX and key in data.bad_chunks:
        return
    if opcode == Opcode.STATISTICS and data.bad_chunks:
        return  # it counts what cannot be read
    if isinstance(told, Statistics) and not data.own:
        # Other writers list channels without messages, too.
        counts = told.channel_message_counts
        told.channel_message_counts = {key: count for key, count in counts.items() if count}
    found = data.listed[opcode].get(key)
    if told != found and (data.own or found is not None):
        yield f"the {_name(opcode)} of the summary is not that of the data"


def _name(opcode: int) -> str:
    return Opcode(opcode).name.lower().replace("_", " ")


def _wrong_offset(
    content: bytes, groups: dict[int, tuple[int, int]], data: WholeData, span: tuple[int, int]
) -> Iterator[str]:
    """Yield a sentence if a summary offset is wrong. The summary before it is `span`."""
    try:
        told = parse(SummaryOffset, content)
    except Damaged as damage:
        yield str(damage)
        return
    group = groups.get(told.group_opcode)
    is_empty = group is None and told.group_length == 0
    if is_empty and not data.own and span[0] <= told.group_start <= span[1]:
        return  # the mcap library names groups without records, too
    if group != (told.group_start, told.group_start + told.group_length):
        yield "a summary offset points elsewhere"
