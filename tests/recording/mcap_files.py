"""MCAP files made record by record, also those that no writer makes."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

import lz4.frame
import zstandard
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, Statistics

from robotctl.recording.format.records import MAGIC, record_bytes

RECORD_HEAD: Final = struct.Struct("<BQ")
DATA_START: Final = len(MAGIC) + len(record_bytes(Header("", "somebody")))
"""Where the records after the header begin, in a file of somebody."""

CHANNEL: Final = record_bytes(Channel(1, "/bomb", "cdr", {}, 0))


def chunk(records: bytes, compression: str = "zstd", level: int = 19) -> bytes:
    """Return a chunk record without a checksum."""
    stored = (
        zstandard.ZstdCompressor(level=level).compress(records)
        if compression == "zstd"
        else lz4.frame.compress(records)
    )
    return stored_chunk(stored, compression, len(records))


def stored_chunk(
    stored: bytes, compression: str, size: int, *, claimed: int | None = None
) -> bytes:
    """Return a chunk record that claims to unpack to `size` bytes, and to store so many."""
    name = compression.encode(errors="surrogateescape")
    content = struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name
    content += struct.pack("<Q", len(stored) if claimed is None else claimed) + stored
    return chunk_record(content)


def chunk_record(content: bytes) -> bytes:
    """Return a chunk record with any content."""
    return RECORD_HEAD.pack(Opcode.CHUNK, len(content)) + content


def finished(
    data: bytes, summary: Iterable[bytes], statistics: Statistics, *, library: str = "somebody"
) -> bytes:
    """Return a file with a summary."""
    start = MAGIC + record_bytes(Header("", library)) + data + record_bytes(DataEnd(0))
    body = b"".join(summary) + record_bytes(statistics)
    footer = record_bytes(Footer(len(start), 0, 0))[:-4]
    crc = crc32(footer, crc32(body)).to_bytes(4, "little")
    return start + body + footer + crc + MAGIC
