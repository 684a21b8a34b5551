"""Reads a stored chunk and checks it against its record.

Every size is checked against the file's limits before anything is decompressed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from typing import Final, NamedTuple

from isal.isal_zlib import crc32
from lz4.frame import LZ4FrameDecompressor
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.recording.format.names import Compression
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.mcap_input import RECORD_HEAD, InputFile
from robotctl.recording.read.read_limits import ReadLimits, unpacking_cost

_PIECE_BYTES = 8 << 20


class Decompressor(NamedTuple):
    """How to undo one compression; both functions get the stored bytes and the original size."""

    unpack: Callable[[bytes, int], bytes]
    """Return the original bytes. It raises Damaged if the data is corrupt, and MemoryError."""

    unpack_torn: Callable[[bytes, int], bytes]
    """Return the original bytes before the place where the data is cut off."""


def _zstd(stored: bytes, size: int) -> bytes:
    try:
        if frame_content_size(stored) not in (-1, size):
            raise Damaged("a chunk's zstd frame has another size than its record")
        return ZstdDecompressor().decompress(stored, max_output_size=size)
    except (ZstdError, ValueError) as error:
        raise Damaged("a chunk's zstd data is corrupt") from error


def _torn_zstd(stored: bytes, size: int) -> bytes:
    pieces: list[bytes] = []
    left = size
    with (
        suppress(ZstdError, ValueError, MemoryError),
        ZstdDecompressor().stream_reader(BytesIO(stored)) as reader,
    ):
        while piece := reader.read(min(_PIECE_BYTES, left)):
            pieces.append(piece)
            left -= len(piece)
    return b"".join(pieces)


def _lz4(stored: bytes, size: int) -> bytes:
    try:
        data: bytes = LZ4FrameDecompressor().decompress(stored, size)
    except (RuntimeError, ValueError) as error:
        raise Damaged("a chunk's lz4 data is corrupt") from error
    return data


def _torn_lz4(stored: bytes, size: int) -> bytes:
    with suppress(RuntimeError, ValueError, MemoryError):
        data: bytes = LZ4FrameDecompressor().decompress(stored, size)
        return data
    return b""


def _plain(stored: bytes, size: int) -> bytes:
    return stored


DECOMPRESSORS: Final[Mapping[str, Decompressor]] = {
    Compression.NONE.mcap_name: Decompressor(_plain, _plain),
    Compression.ZSTD.mcap_name: Decompressor(_zstd, _torn_zstd),
    "lz4": Decompressor(_lz4, _torn_lz4),
}
"""The decompressors by the compression's name in a chunk record."""


def decompressor_of(name: str) -> Decompressor:
    """Return the decompressor of a compression.

    Raises:
        Damaged: The compression is not supported.
    """
    found = DECOMPRESSORS.get(name)
    if found is None:
        raise Damaged(f"a chunk is compressed by {name!r}, which is not supported")
    return found


_CHUNK_FIELDS: Final = struct.Struct("<QQQI")
"""The beginning of a chunk: start and end time [ns], uncompressed size [bytes] and CRC."""

_MAX_NAME_BYTES = 32
_PREFIX_BYTES = RECORD_HEAD.size + _CHUNK_FIELDS.size + 4 + _MAX_NAME_BYTES + 8


@dataclass(frozen=True, slots=True)
class ChunkRef:
    """Where a chunk's data is, and what its record says about it (times in ns)."""

    data_offset: int
    data_size: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int


class UnpackBudget:
    """How many bytes a search for chunks in a damaged file may still decompress."""

    def __init__(self, limits: ReadLimits) -> None:
        self._limit = limits.unpacked_cost
        self._left = limits.unpacked_cost

    def spend(self, unpacked_bytes: int) -> None:
        """Count a chunk of this size.

        Raises:
            BeyondLimit: The budget is exhausted.
        """
        self._left -= unpacking_cost(unpacked_bytes)
        if self._left < 0:
            raise BeyondLimit(f"unpacked it would take more than {self._limit >> 20} MiB")


def read_chunk_ref(file: InputFile, offset: int, length: int) -> ChunkRef:
    """Parse the head of the chunk record at `offset`; the record has `length` bytes in all.

    Raises:
        Damaged: At `offset` is no chunk record of that length.
    """
    prefix = file.read(offset, min(_PREFIX_BYTES, length))
    try:
        opcode, content_size = RECORD_HEAD.unpack_from(prefix)
        if (opcode, content_size) != (Opcode.CHUNK, length - RECORD_HEAD.size):
            raise Damaged(_instead_of_a_chunk(prefix))
        start_ns, end_ns, uncompressed_size, crc = _CHUNK_FIELDS.unpack_from(
            prefix, RECORD_HEAD.size
        )
        name_start = RECORD_HEAD.size + _CHUNK_FIELDS.size + 4
        (name_size,) = struct.unpack_from("<I", prefix, name_start - 4)
        if name_size > _MAX_NAME_BYTES:
            raise Damaged(f"the compression of a chunk has a name of {name_size} bytes")
        name_end = name_start + name_size
        compression = prefix[name_start:name_end].decode()
        (data_size,) = struct.unpack_from("<Q", prefix, name_end)
    except (struct.error, ValueError) as error:
        raise Damaged("the head of a chunk is malformed") from error
    data_offset = offset + name_end + 8
    if data_offset + data_size != offset + length:
        raise Damaged("a chunk's data is not as long as its record")
    return ChunkRef(data_offset, data_size, compression, uncompressed_size, crc, start_ns, end_ns)


def stored_size_of(length: int, compression: str) -> int:
    """Return how many bytes of data are in a chunk record of `length` bytes."""
    return length - RECORD_HEAD.size - _CHUNK_FIELDS.size - 4 - len(compression.encode()) - 8


def read_chunk(file: InputFile, ref: ChunkRef) -> bytes:
    """Return the chunk's records, decompressed and checked.

    Raises:
        Damaged: The chunk is corrupt, or exceeds the limits.
    """
    _check_size(file, ref)
    try:
        stored = file.read(ref.data_offset, ref.data_size)
        data = decompressor_of(ref.compression).unpack(stored, ref.uncompressed_size)
    except MemoryError as error:
        raise file.failed(f"no memory for a chunk of {ref.uncompressed_size} bytes") from error
    if len(data) != ref.uncompressed_size:
        raise Damaged(f"a chunk has {len(data)} bytes instead of {ref.uncompressed_size}")
    if ref.crc and crc32(data) != ref.crc:
        raise Damaged("a chunk's checksum is wrong")
    return data


def read_torn_chunk(file: InputFile, ref: ChunkRef) -> bytes:
    """Return what can be decompressed of a chunk that the end of the file cuts off, unchecked."""
    _check_size(file, ref)
    stored = file.read(ref.data_offset, max(min(ref.data_size, file.size - ref.data_offset), 0))
    return decompressor_of(ref.compression).unpack_torn(stored, ref.uncompressed_size)


def _instead_of_a_chunk(found: bytes) -> str:
    if not any(found):
        return "the chunk was replaced by zeros, which a power cut can cause"
    return "there is no chunk of this length"


def _check_size(file: InputFile, ref: ChunkRef) -> None:
    limits = file.limits
    if ref.uncompressed_size > max(limits.chunk_bytes, limits.chunk_ratio * ref.data_size):
        raise BeyondLimit(
            f"a chunk claims to unpack to {ref.uncompressed_size} bytes, "
            f"more than {limits.chunk_bytes}"
        )
