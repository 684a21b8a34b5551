"""A writer whose MCAP file is complete and valid after every write.

Each `commit` puts, by one positioned write at the end of the data, whatever is new and then a
whole trailer: DataEnd, summary, footer, magic. The next commit overwrites that trailer. So any
reader opens the file at any moment, also after the process was killed, without a recovery step.

Specification: https://mcap.dev/spec. The records come from the `mcap` package, except for what
is written per message or per chunk (message, message index, head of a chunk).
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self

from isal.isal_zlib import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from robotctl.recording.storage import Buffer, Storage

MAGIC: Final = b"\x89MCAP0\r\n"
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""opcode, record length, channel id, sequence, log time [ns], publish time [ns]."""

MESSAGE_FIELDS_BYTES: Final = 22
"""What the record length of a message counts besides its data."""

_CHUNK_HEAD = struct.Struct("<BQQQQI")
_MESSAGE_INDEX_HEAD = struct.Struct("<BQHI")
_CRC = struct.Struct("<I")
_INDEX_ENTRY_BYTES = 16
_CRC_AND_MAGIC_BYTES = _CRC.size + len(MAGIC)

_SUMMARY_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


def record_bytes(record: McapRecord) -> bytes:
    """The record as it stands in a file, with opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # the package leaves it untyped
    return data


def _utf8(text: str) -> str:
    return text.encode(errors="backslashreplace").decode()


@dataclass(frozen=True, slots=True)
class Chunk:
    """Messages to be written as one MCAP chunk.

    `parts` are the chunk's records as they will be stored (compressed or not); `indexes` gives,
    for each channel in it, an array('Q') of log time [ns] and offset in the uncompressed chunk,
    alternating; start and end are the lowest and highest log time [ns].
    """

    parts: Sequence[Buffer]
    compression: str
    uncompressed_size: int
    uncompressed_crc: int
    start_ns: int
    end_ns: int
    indexes: Mapping[int, array[int]]


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """The end of a valid file without attachments, as it was read.

    `data_end` is the offset of its DataEnd record, `data_crc` the checksum therein; `groups`
    holds the summary's records by their opcode, the way they stand there.
    """

    data_end: int
    data_crc: int
    groups: Mapping[Opcode, bytes]
    statistics: Statistics


@dataclass(frozen=True, slots=True)
class _Good:
    """The state of the last write that succeeded: enough to write its trailer again."""

    data_end: int
    data_crc: int
    statistics: bytes
    group_sizes: Mapping[Opcode, int]


class McapFile:
    """The one writer of one MCAP file. Not thread-safe.

    Records are collected by the `add_` methods and reach the file with the next `commit`.
    """

    def __init__(self, storage: Storage, *, profile: str, library: str) -> None:
        """Begin the file; nothing is written before the first `commit`."""
        self._storage = storage
        self._pending = bytearray(MAGIC + record_bytes(Header(profile, library)))
        self._groups = {opcode: bytearray() for opcode in _SUMMARY_GROUPS}
        self._data_end = 0
        self._data_crc = 0
        self._size = 0
        self._trailer_bytes = 0
        self._schema_count = 0
        self._channel_count = 0
        self._chunk_count = 0
        self._attachment_count = 0
        self._metadata_count = 0
        self._counts: dict[int, int] = {}
        self._start_ns = 0
        self._end_ns = 0
        self._good: _Good | None = None

    @classmethod
    def resume(cls, storage: Storage, written: WrittenFile) -> Self:
        """Go on writing a finished file: what is added goes between its data and a new trailer."""
        self = cls(storage, profile="", library="")
        self._pending.clear()
        self._data_end = written.data_end
        self._data_crc = written.data_crc
        for opcode, group in self._groups.items():
            group += written.groups.get(opcode, b"")
        statistics = written.statistics
        self._schema_count = statistics.schema_count
        self._channel_count = statistics.channel_count
        self._chunk_count = statistics.chunk_count
        self._metadata_count = statistics.metadata_count
        self._counts = dict(statistics.channel_message_counts)
        self._start_ns = statistics.message_start_time
        self._end_ns = statistics.message_end_time
        return self

    @property
    def size(self) -> int:
        """Bytes of the file, trailer included."""
        return self._size

    @property
    def trailer_bytes(self) -> int:
        """Bytes written so far that a later commit overwrote or will overwrite."""
        return self._trailer_bytes

    @property
    def start_ns(self) -> int:
        """Lowest log time in the file [ns]; 0 while it holds no message."""
        return self._start_ns

    @property
    def end_ns(self) -> int:
        """Highest log time in the file [ns]; 0 while it holds no message."""
        return self._end_ns

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages per channel id, of channels that have any."""
        return self._counts

    def add_schema(self, schema: Schema) -> None:
        """Add a schema; its id must be new and not 0."""
        data = record_bytes(schema)
        self._pending += data
        self._groups[Opcode.SCHEMA] += data
        self._schema_count += 1

    def add_channel(self, channel: Channel) -> None:
        """Add a channel; its id must be new and its schema added before."""
        data = record_bytes(channel)
        self._pending += data
        self._groups[Opcode.CHANNEL] += data
        self._channel_count += 1

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named map of strings; what is no UTF-8, as in a file's name, is escaped."""
        plain = {_utf8(key): _utf8(value) for key, value in values.items()}
        data = record_bytes(Metadata(name=name, metadata=plain))
        offset = self._data_end + len(self._pending)
        index = MetadataIndex(offset=offset, length=len(data), name=name)
        self._pending += data
        self._groups[Opcode.METADATA_INDEX] += record_bytes(index)
        self._metadata_count += 1

    def add_attachment(self, attachment: Attachment) -> None:
        """Add a file of another kind."""
        data = record_bytes(attachment)
        index = AttachmentIndex(
            offset=self._data_end + len(self._pending),
            length=len(data),
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._pending += data
        self._groups[Opcode.ATTACHMENT_INDEX] += record_bytes(index)
        self._attachment_count += 1

    def commit(self, chunk: Chunk | None = None, *, finished: bool = True) -> None:
        """Write what was added, then `chunk`, then the trailer, by one positioned write.

        Without the trailer (`finished` False) the file is not valid before another commit: for
        files that nobody needs before they are complete. Raises OSError; the file may then be
        torn until `cut_back` has repaired it.
        """
        parts: list[Buffer] = [bytes(self._pending)]
        end = self._data_end + len(self._pending)
        if chunk is not None:
            chunk_parts, index = self._encode_chunk(chunk, end)
            parts += chunk_parts
            end = index.chunk_start_offset + index.chunk_length + index.message_index_length
            self._groups[Opcode.CHUNK_INDEX] += record_bytes(index)
            self._count(chunk)
        crc = self._data_crc
        for part in parts:
            crc = crc32(part, crc)
        good = _Good(
            data_end=end,
            data_crc=crc,
            statistics=record_bytes(self._statistics()),
            group_sizes={opcode: len(group) for opcode, group in self._groups.items()},
        )
        trailer, trailer_size = self._trailer(good) if finished else ([], 0)
        self._storage.write_at([*parts, *trailer], self._data_end)
        self._pending.clear()
        self._data_end = end
        self._data_crc = crc
        self._size = end + trailer_size
        self._trailer_bytes += trailer_size
        if finished:
            self._good = good

    def cut_back(self) -> None:
        """After a failed `commit`: restore the file as the last good commit had left it.

        Nothing may be added or committed afterwards. Raises OSError.
        """
        good = self._good
        if good is None:
            self._storage.truncate(0)
            return
        trailer, trailer_size = self._trailer(good)
        self._storage.write_at(trailer, good.data_end)
        self._storage.truncate(good.data_end + trailer_size)

    def sync(self) -> None:
        """Force everything committed to the disk. Raises OSError."""
        self._storage.sync()

    def close(self) -> None:
        """Close the file as the last commit has left it. Raises OSError."""
        self._storage.close()

    def _encode_chunk(self, chunk: Chunk, offset: int) -> tuple[list[Buffer], ChunkIndex]:
        compression = chunk.compression.encode()
        stored_size = sum(map(len, chunk.parts))
        head = (
            _CHUNK_HEAD.pack(
                Opcode.CHUNK,
                _CHUNK_HEAD.size - 9 + 4 + len(compression) + 8 + stored_size,
                chunk.start_ns,
                chunk.end_ns,
                chunk.uncompressed_size,
                chunk.uncompressed_crc,
            )
            + len(compression).to_bytes(4, "little")
            + compression
            + stored_size.to_bytes(8, "little")
        )
        chunk_length = len(head) + stored_size
        index_offsets: dict[int, int] = {}
        indexes = bytearray()
        for channel, entries in chunk.indexes.items():
            index_offsets[channel] = offset + chunk_length + len(indexes)
            size = len(entries) * entries.itemsize
            indexes += _MESSAGE_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size)
            indexes += entries.tobytes()
        index = ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=stored_size,
            message_end_time=chunk.end_ns,
            message_index_length=len(indexes),
            message_index_offsets=index_offsets,
            message_start_time=chunk.start_ns,
            uncompressed_size=chunk.uncompressed_size,
        )
        return [head, *chunk.parts, indexes], index

    def _count(self, chunk: Chunk) -> None:
        first = self._chunk_count == 0
        self._start_ns = chunk.start_ns if first else min(self._start_ns, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        self._chunk_count += 1
        for channel, entries in chunk.indexes.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(entries) // 2

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=self._attachment_count,
            channel_count=self._channel_count,
            channel_message_counts=self._counts,
            chunk_count=self._chunk_count,
            message_count=sum(self._counts.values()),
            message_end_time=self._end_ns,
            message_start_time=self._start_ns,
            metadata_count=self._metadata_count,
            schema_count=self._schema_count,
        )

    def _trailer(self, good: _Good) -> tuple[list[Buffer], int]:
        """The parts of DataEnd, summary, footer and magic, and their size in bytes."""
        data_end = record_bytes(DataEnd(data_section_crc=good.data_crc))
        summary_start = good.data_end + len(data_end)
        parts: list[Buffer] = []
        offsets = bytearray()
        position = summary_start
        for opcode, group in self._groups.items():
            size = len(good.statistics) if opcode is Opcode.STATISTICS else good.group_sizes[opcode]
            if not size:
                continue
            parts.append(
                good.statistics if opcode is Opcode.STATISTICS else memoryview(group)[:size]
            )
            offsets += record_bytes(SummaryOffset(opcode, position, size))
            position += size
        footer = record_bytes(Footer(summary_start, position, 0))[: -_CRC.size]
        parts += [offsets, footer]
        crc = 0
        for part in parts:
            crc = crc32(part, crc)
        parts = [data_end, *parts, _CRC.pack(crc), MAGIC]
        return parts, position - good.data_end + len(offsets) + len(footer) + _CRC_AND_MAGIC_BYTES
