"""The records of MCAP as robotctl writes them. Specification: https://mcap.dev/spec."""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, McapRecord, Schema

from robotctl.recording.format.disk import Buffer

_TWO_PARTS = re.compile(r"([a-z][a-z0-9_]*)/([A-Z][A-Za-z0-9]*)")


def type_name_of(channel: Channel, schema: Schema | None) -> str:
    """Return the message type of a channel, "" if the channel has no schema.

    In CDR, the type `pkg/T` of some tools becomes `pkg/msg/T`.
    """
    name = schema.name if schema else ""
    if channel.message_encoding != "cdr":
        return name
    match = _TWO_PARTS.fullmatch(name)
    return f"{match[1]}/msg/{match[2]}" if match else name


MAGIC: Final = b"\x89MCAP0\r\n"
PlainMessage = tuple[int, bytes, int, int, int]
"""Channel id, data, log time [ns], publish time [ns], sequence number."""

MAX_TIME_NS: Final = 2**64 - 1
MAX_SEQUENCE: Final = 2**32 - 1
"""The largest values in MCAP. Larger times are clamped, sequence numbers wrap."""

MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""Opcode, record length, channel id, sequence, log time [ns], publish time [ns]."""

MESSAGE_FIELDS_BYTES: Final = 22
"""Content length of a message record without data."""

RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode and content length, before the content of each record."""

RECORD_HEAD_BYTES: Final = RECORD_HEAD.size
DATA_END_BYTES: Final = RECORD_HEAD_BYTES + 4
FOOTER_CONTENT_BYTES: Final = 20

FIRST_PRIVATE_OPCODE: Final = 0x80
"""The first opcode for applications. Readers skip unknown opcodes."""

ROOM_OPCODE: Final = 0x86
"""Private opcode of the record that reserves room for more data in a growing file."""

_CHUNK_HEAD = struct.Struct("<BQQQQI")
_MESSAGE_INDEX_HEAD = struct.Struct("<BQHI")


def record_bytes(record: McapRecord) -> bytes:
    """Return the record with opcode and length, as in a file."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # the package leaves it untyped
    return data


def room_head(start: int, end: int) -> bytes:
    """Return the head of a filler record that reserves bytes `start` to `end` for later data."""
    return RECORD_HEAD.pack(ROOM_OPCODE, end - start - RECORD_HEAD_BYTES)


@dataclass(frozen=True, slots=True)
class Chunk:
    """Messages to write as one MCAP chunk.

    `parts` are the records as stored. `indexes` has an array per channel: log time [ns], offset in
    the uncompressed chunk, next time, next offset, ... `start_ns` and `end_ns` are log times.
    """

    parts: Sequence[Buffer]
    compression: str
    uncompressed_size: int
    uncompressed_crc: int
    start_ns: int
    end_ns: int
    indexes: Mapping[int, array[int]]

    @property
    def stored_size(self) -> int:
        """The stored size of the records [bytes]."""
        return sum(map(len, self.parts))


class PlacedChunk(NamedTuple):
    """A chunk at an offset of a file, followed by its message indexes."""

    head: bytes
    """The beginning of the record, before the stored messages."""

    parts: Sequence[Buffer]
    """The stored messages, which are the rest of the record."""

    message_indexes: bytes
    entry: ChunkIndex
    """The entry of the chunk in the summary."""

    @property
    def end(self) -> int:
        """The file offset after the chunk record and its message indexes."""
        entry = self.entry
        return entry.chunk_start_offset + entry.chunk_length + entry.message_index_length


def place(chunk: Chunk, offset: int) -> PlacedChunk:
    """Return `chunk` as written at the file offset `offset`, with its entry in the summary."""
    compression = chunk.compression.encode()
    stored_size = chunk.stored_size
    head = (
        _CHUNK_HEAD.pack(
            Opcode.CHUNK,
            _CHUNK_HEAD.size - RECORD_HEAD_BYTES + 4 + len(compression) + 8 + stored_size,
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
    entry = ChunkIndex(
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
    return PlacedChunk(head, chunk.parts, bytes(indexes), entry)
