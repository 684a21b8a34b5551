"""Reads every byte of a file's data section, and checks each record against the others.

Records of robotctl are compared byte for byte with what its writer writes for the same content.
In files of other writers, only a contradiction is a flaw.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from math import inf

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, DataEnd, McapRecord, Metadata, MetadataIndex

from robotctl.recording.format.records import (
    FIRST_PRIVATE_OPCODE,
    MAGIC,
    ROOM_OPCODE,
    Chunk,
    place,
    record_bytes,
)
from robotctl.recording.format.seal_records import LINK_OPCODE, OPENING_OPCODE
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.file_index import (
    read_attachment,
    read_content,
    read_header,
    read_record_head,
)
from robotctl.recording.read.mcap_input import (
    MESSAGE_FIELDS,
    RECORD_HEAD,
    TOO_MANY_RECORDS,
    InputFile,
    head_blocks,
    parse,
)
from robotctl.recording.read.stored_chunk import (
    ChunkRef,
    UnpackBudget,
    read_chunk,
    read_chunk_ref,
)
from robotctl.recording.read.whole_data import Flaws, WholeData

_INDEX_HEAD_BYTES = 6
"""Channel id and length of the entries, at the beginning of a message index."""


class WholeChunks:
    """Checks the chunks of one file in file order."""

    def __init__(self, file: InputFile, data: WholeData, flaws: Flaws) -> None:
        self._file = file
        self._data = data
        self._flaws = flaws
        self._budget = UnpackBudget(file.limits)
        self._entry: ChunkIndex | None = None
        self._skip = False
        self._expected: dict[int, bytes] = {}
        """The entries of the message indexes that must still follow the last chunk, by channel."""

    def chunk(self, offset: int, end: int, most: int) -> int:
        """Check the chunk at `offset`, and return how many records it holds.

        Raises:
            Damaged: The disk or the memory fails.
            BeyondLimit: It holds more than `most` records, or is too large.
        """
        file, data = self._file, self._data
        try:
            ref = read_chunk_ref(file, offset, end - offset)
            self._budget.spend(ref.uncompressed_size)
            content = read_chunk(file, ref)
            indexes, count = self._read(content, (offset, end), most)
        except BeyondLimit:
            raise
        except Damaged as damage:
            if file.failure:
                raise
            self._flaws.add(offset, end, str(damage))
            self._skip = True
            data.bad_chunks.add(offset)
            return 0
        spans = [
            (channel, len(entries) // 2, min(entries[::2]), max(entries[::2]))
            for channel, entries in indexes.items()
        ]
        if spans and (min(span[2] for span in spans), max(span[3] for span in spans)) != (
            ref.start_ns,
            ref.end_ns,
        ):
            self._flaws.add(offset, end, "a chunk holds messages of other times than it says")
        data.begin_chunk()
        for span in spans:
            data.add_messages(*span)
        self._entry = self._placed(ref, offset, end, empty=not spans)
        data.chunk_indexes[offset] = self._entry
        self._expected = {
            channel: array("Q", entries).tobytes() for channel, entries in indexes.items()
        }
        return count

    def message_index(self, offset: int, content: bytes) -> None:
        """Check the message index record at `offset` with this content."""
        if self._skip:
            return  # their chunk cannot be read
        end = offset + RECORD_HEAD.size + len(content)
        channel = int.from_bytes(content[:2], "little")
        size = int.from_bytes(content[2:_INDEX_HEAD_BYTES], "little")
        expected = self._expected.pop(channel, None)
        if self._entry is None:
            self._flaws.add(offset, end, "a message index follows no chunk")
            return
        self._entry.message_index_offsets[channel] = offset
        self._entry.message_index_length += end - offset
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
            self._flaws.add(offset, end, "a message index does not fit the messages of its chunk")

    def end(self, offset: int) -> None:
        """Note that the last chunk and its message indexes end at `offset`."""
        missing = self._expected and (self._data.own or self._entry_has_indexes())
        if missing and self._entry is not None:
            start = self._entry.chunk_start_offset
            self._flaws.add(start, offset, "a chunk lacks a message index")
        self._expected = {}
        self._entry = None
        self._skip = False

    def _entry_has_indexes(self) -> bool:
        return self._entry is not None and bool(self._entry.message_index_offsets)

    def _placed(self, ref: ChunkRef, offset: int, end: int, *, empty: bool) -> ChunkIndex:
        stored = memoryview(self._file.read(ref.data_offset, ref.data_size))
        described = Chunk(
            [stored], ref.compression, ref.uncompressed_size, ref.crc, ref.start_ns, ref.end_ns, {}
        )
        placed = place(described, offset)
        if self._data.own and (
            empty or not ref.crc or placed.head != self._file.read(offset, len(placed.head))
        ):
            self._flaws.add(offset, end, "a chunk is not as robotctl writes it")
        return placed.entry

    def _read(
        self, content: bytes, at: tuple[int, int], most: int
    ) -> tuple[dict[int, list[int]], int]:
        """Return log time and offset of each message by channel, and the number of records."""
        data = self._data
        indexes: dict[int, list[int]] = {}
        count, message = 0, Opcode.MESSAGE.value
        for block in head_blocks(content, most):
            count += len(block)
            for position, (opcode, length, channel, _, log_ns, _) in block:
                if opcode == message:
                    entries = indexes.get(channel)
                    if entries is None:
                        entries = indexes[channel] = self._entries_of(channel)
                    entries += log_ns, position
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    start = position + RECORD_HEAD.size
                    data.define(opcode, content[start : start + length], at, self._flaws)
        return indexes, count

    def _entries_of(self, channel: int) -> list[int]:
        """Return an empty list for the message index entries of a channel.

        Raises:
            Damaged: No record has described the channel.
        """
        if channel not in self._data.channels:
            raise Damaged(f"a chunk holds messages of channel {channel}, without a topic")
        return []


def _sorted(entries: bytes) -> list[tuple[int, int]]:
    """Return the entries of a message index, sorted: other writers may sort them by time."""
    values = array("Q", entries[: len(entries) // 16 * 16])
    return sorted(zip(values[::2], values[1::2], strict=True))


_PIECE_BYTES = 1 << 20


def read_data_section(
    file: InputFile,
    flaws: Flaws,
    stop: int | None = None,
    on_progress: Callable[[int], None] = lambda offset: None,
) -> WholeData:
    """Read the data section up to its DataEnd record, or up to `stop` if that is given.

    `on_progress` gets the offset that is reached.

    Raises:
        Damaged: The file does not begin as an MCAP file, or the disk fails.
    """
    return _DataSection(file, flaws, stop, on_progress).read()


class _DataSection:
    """A data section that is read record by record."""

    def __init__(
        self,
        file: InputFile,
        flaws: Flaws,
        stop: int | None = None,
        on_progress: Callable[[int], None] = lambda offset: None,
    ) -> None:
        """Read the header; see `read_data_section`.

        Raises:
            Damaged: The file does not begin as an MCAP file, or the disk fails.
        """
        header, offset = read_header(file)
        data = WholeData(header)
        if data.own and record_bytes(header) != file.read(len(MAGIC), offset - len(MAGIC)):
            flaws.add(len(MAGIC), offset, "the header is not as robotctl writes it")
        self._file = file
        self._data = data
        self._flaws = flaws
        self._reading = _Reading(file, data, flaws)
        self._checksum = _Checksum(file)
        self._on_progress = on_progress
        self._offset = offset
        self._stop: float = inf if stop is None else stop

    def read(self) -> WholeData:
        """Return what was found.

        Raises:
            Damaged: The disk fails.
        """
        while self._offset < self._stop:
            self._read_record()
        data, checksum = self._data, self._checksum
        checksum.add_up_to(self._offset)
        data.end, data.crc = self._offset, checksum.crc
        return data

    def _read_record(self) -> None:
        """Read one record, or stop at DataEnd or at a record that cannot be read.

        Raises:
            Damaged: The disk fails.
        """
        file, data, offset = self._file, self._data, self._offset
        end = None
        try:
            end = self._reading.record(offset)
        except BeyondLimit as limit:
            data.unread = f"the data after byte {offset} is not read: {limit}"
        except Damaged as damage:
            if file.failure:
                raise file.failure from None
            self._flaws.add(offset, min(offset + RECORD_HEAD.size, file.size), str(damage))
            data.unread = f"the data after byte {offset} is not read"
        if end is None:
            self._stop = offset
            return
        self._on_progress(offset)
        self._offset = end
        if end - self._checksum.end > _PIECE_BYTES:
            self._checksum.add_up_to(end)


class _Checksum:
    """The CRC of a file's bytes up to `end`. It reads them again while they are cached."""

    def __init__(self, file: InputFile) -> None:
        self._file = file
        self.end = 0
        self.crc = 0

    def add_up_to(self, end: int) -> None:
        """Continue the CRC up to `end`.

        Raises:
            Damaged: The bytes cannot be read.
        """
        while self.end < end:
            piece = self._file.read(self.end, min(_PIECE_BYTES, end - self.end))
            self.crc = crc32(piece, self.crc)
            self.end += len(piece)


class _Reading:
    """One pass over the records of a data section."""

    def __init__(self, file: InputFile, data: WholeData, flaws: Flaws) -> None:
        self._file = file
        self._data = data
        self._flaws = flaws
        self._chunks = WholeChunks(file, data, flaws)
        self._records = 0

    def record(self, offset: int) -> int | None:
        """Check the record at `offset`; return the offset after it, None for DataEnd.

        Raises:
            Damaged: There is no valid record, so what follows cannot be read.
        """
        file, data = self._file, self._data
        opcode, length = read_record_head(file, offset)
        end = offset + RECORD_HEAD.size + length
        if end > file.size:
            raise Damaged(f"a record claims to have {length} bytes, more than are left")
        self._records += 1
        if self._records > file.limits.records:
            raise BeyondLimit(TOO_MANY_RECORDS)
        if opcode == Opcode.MESSAGE_INDEX:
            if data.unfinished is None:
                self._chunks.message_index(offset, read_content(file, offset, length))
            return end
        self._chunks.end(offset)
        if data.unfinished is not None and opcode != Opcode.DATA_END:
            raise Damaged("records follow a commit that was not finished")
        if opcode == Opcode.CHUNK:
            left = file.limits.records - self._records
            self._records += self._chunks.chunk(offset, end, left)
            return end
        if opcode == Opcode.ATTACHMENT:
            self._attachment(offset, end)
            return end
        if opcode == ROOM_OPCODE and data.own:
            data.unfinished = offset
            return end
        if opcode in (OPENING_OPCODE, LINK_OPCODE) or (
            opcode >= FIRST_PRIVATE_OPCODE and not data.own
        ):
            data.private.append((opcode, offset, length))
            return end
        if opcode == Opcode.DATA_END:
            data.told_crc = parse(DataEnd, read_content(file, offset, length)).data_section_crc
            return None
        if not self._is_expected(opcode, length):
            raise Damaged(
                f"no record of kind {opcode} belongs here" if opcode else "they are zeros"
            )
        try:
            self._single(opcode, offset, read_content(file, offset, length))
        except Damaged as damage:
            if file.failure:
                raise
            self._flaws.add(offset, end, str(damage))
        return end

    def _is_expected(self, opcode: int, length: int) -> bool:
        if opcode == Opcode.MESSAGE:
            return not self._data.own and length >= MESSAGE_FIELDS.size
        return opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)

    def _single(self, opcode: int, offset: int, content: bytes) -> None:
        """Check a record that belongs to no chunk.

        Raises:
            Damaged: It is malformed.
        """
        data = self._data
        end = offset + RECORD_HEAD.size + len(content)
        if opcode == Opcode.MESSAGE:
            channel, _, log_ns, _ = MESSAGE_FIELDS.unpack_from(content)
            data.add_messages(channel, 1, log_ns, log_ns)
        elif opcode == Opcode.METADATA:
            record: Metadata = parse(Metadata, content)
            data.metadata[offset] = record
            data.metadata_indexes[offset] = MetadataIndex(offset, end - offset, record.name)
            self._compare(offset, record, content)
        else:
            self._compare(offset, data.define(opcode, content, (offset, end), self._flaws), content)

    def _compare(self, offset: int, record: McapRecord, content: bytes) -> None:
        """Compare a record of robotctl with what its writer writes for the same content."""
        if self._data.own and record_bytes(record)[RECORD_HEAD.size :] != content:
            end = offset + RECORD_HEAD.size + len(content)
            self._flaws.add(offset, end, "a record is not as robotctl writes it")

    def _attachment(self, offset: int, end: int) -> None:
        try:
            found = read_attachment(self._file, offset)
        except BeyondLimit:
            raise
        except Damaged as damage:
            self._flaws.add(offset, end, f"an attachment: {damage}")
            return
        self._data.attachment_indexes[offset] = AttachmentIndex(
            offset=offset,
            length=end - offset,
            log_time=found.log_time,
            create_time=found.create_time,
            data_size=len(found.data),
            name=found.name,
            media_type=found.media_type,
        )
