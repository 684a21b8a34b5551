"""Decompress stored chunks and messages within the limits of their file."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple

from isal.isal_zlib import crc32
from lz4.frame import LZ4FrameDecompressor
from mcap.opcode import Opcode
from mcap.records import Metadata
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.recording.format.names import Compression
from robotctl.recording.format.rosbag2 import METADATA_RECORD, files_in, metadata_text
from robotctl.recording.read.read_limits import (
    BeyondLimit,
    Damaged,
    ReadLimits,
    Tally,
    UnpackBudget,
    beyond_unpacking,
    unpacking_cost,
)
from robotctl.recording.read.records import RECORD_HEAD, InputFile, walk_records

_PIECE_BYTES: Final = 8 << 20
_LZ4: Final = "lz4"
_NAMES: Final = (Compression.NONE.mcap_name, Compression.ZSTD.mcap_name, _LZ4)
"""The compressions by their names in a chunk record."""

_FIELDS: Final = struct.Struct("<QQQII")
"""Start and end time [ns], uncompressed size, CRC, and length of the compression's name [bytes]."""

_BEFORE_NAME: Final = RECORD_HEAD.size + _FIELDS.size
_MAX_NAME_BYTES: Final = 32


def unpack(compression: str, stored: bytes, size: int, *, torn: bool = False) -> bytes:
    """Return the decompressed data of a chunk of `size` bytes, or the readable part if `torn`.

    Raises:
        Damaged: The data is corrupt, or the compression is not supported.
        MemoryError: There is no memory.
    """
    if compression not in _NAMES:
        raise Damaged(f"a chunk is compressed by {compression!r}, which is not supported")
    try:
        if compression == Compression.ZSTD.mcap_name:
            if torn:
                return _torn_zstd(stored, size)
            if frame_content_size(stored) not in (-1, size):
                raise Damaged("a chunk's zstd frame has another size than its record")
            return ZstdDecompressor().decompress(stored, max_output_size=size)
        if compression == _LZ4:
            data: bytes = LZ4FrameDecompressor().decompress(stored, size)
            return data
    except (ZstdError, RuntimeError, ValueError, MemoryError) as error:
        if torn:
            return b""
        if isinstance(error, MemoryError):
            raise
        raise Damaged(f"a chunk's {compression} data is corrupt") from error
    return stored


def _torn_zstd(stored: bytes, size: int) -> bytes:
    data = bytearray()
    try:
        with ZstdDecompressor().stream_reader(BytesIO(stored)) as reader:
            while piece := reader.read(min(_PIECE_BYTES, size - len(data))):
                data += piece
    except (ZstdError, ValueError, MemoryError):
        pass
    return bytes(data)


class ChunkHead(NamedTuple):
    """The place of a chunk's data, and the fields of its record (times in ns)."""

    data_offset: int
    data_size: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int


def read_chunk_head(file: InputFile, offset: int, length: int) -> ChunkHead:
    """Return the head of the chunk record of `length` bytes at `offset`.

    Raises:
        Damaged: There is no chunk record of that length at `offset`.
    """
    prefix = file.read(offset, min(_BEFORE_NAME + _MAX_NAME_BYTES + 8, length))
    try:
        if RECORD_HEAD.unpack_from(prefix) != (Opcode.CHUNK, length - RECORD_HEAD.size):
            if any(prefix):
                raise Damaged("there is no chunk of this length")
            raise Damaged("the chunk was replaced by zeros, which a power cut can cause")
        start_ns, end_ns, size, crc, name_size = _FIELDS.unpack_from(prefix, RECORD_HEAD.size)
        if name_size > _MAX_NAME_BYTES:
            raise Damaged(f"the compression of a chunk has a name of {name_size} bytes")
        name_end = _BEFORE_NAME + name_size
        compression = prefix[_BEFORE_NAME:name_end].decode()
        (data_size,) = struct.unpack_from("<Q", prefix, name_end)
    except (struct.error, ValueError) as error:
        raise Damaged("the head of a chunk is malformed") from error
    if name_end + 8 + data_size != length:
        raise Damaged("a chunk's data is not as long as its record")
    return ChunkHead(offset + name_end + 8, data_size, compression, size, crc, start_ns, end_ns)


def stored_size_of(length: int, compression: str) -> int:
    """Return the size [bytes] of the stored data in a chunk record of `length` bytes."""
    return length - _BEFORE_NAME - len(compression.encode()) - 8


def read_chunk(file: InputFile, head: ChunkHead, *, torn: bool = False) -> bytes:
    """Return the decompressed records of a chunk, the readable part of a `torn` one.

    Raises:
        Damaged: The chunk is corrupt, or exceeds the limits.
    """
    size, limits = head.uncompressed_size, file.limits
    if size > max(limits.chunk_bytes, limits.chunk_ratio * head.data_size):
        raise BeyondLimit(
            f"a chunk claims to unpack to {size} bytes, more than {limits.chunk_bytes}"
        )
    there = max(min(head.data_size, file.size - head.data_offset), 0) if torn else head.data_size
    try:
        stored = file.read(head.data_offset, there)
        data = unpack(head.compression, stored, size, torn=torn)
    except MemoryError as error:
        raise file.failed(f"no memory for a chunk of {size} bytes") from error
    if torn:
        return data
    if len(data) != size:
        raise Damaged(f"a chunk has {len(data)} bytes instead of {size}")
    if head.crc and crc32(data) != head.crc:
        raise Damaged("a chunk's checksum is wrong")
    return data


_WINDOW_BYTES: Final = 4 << 20
_PACKED_NAMES: Final = [struct.pack("<I", len(name)) + name.encode() for name in _NAMES]
_HEAD = re.compile(
    rb"\x06(?=.{8}.{28}(?:%b))" % b"|".join(map(re.escape, _PACKED_NAMES)), re.DOTALL
)
"""The opcode of a chunk, followed by lengths, times, sizes and a known compression."""

_HEAD_BYTES: Final = _BEFORE_NAME + max(map(len, _NAMES)) + 8
"""The maximum length of a chunk's fields before its data, from the opcode on [bytes]."""


def find_chunk(file: InputFile, offset: int, budget: UnpackBudget) -> int | None:
    """Return the offset of the first valid chunk at or after `offset`, None if there is none.

    Raises:
        BeyondLimit: The search would cost more than `budget`.
    """
    while offset < file.size:
        window = file.read(offset, min(_WINDOW_BYTES + _HEAD_BYTES, file.size - offset))
        for match in _HEAD.finditer(window):
            at = offset + match.start()
            if _lengths_agree(window, match.start()) and _is_whole(file, at, budget):
                return at
        offset += _WINDOW_BYTES
    return None


def _lengths_agree(window: bytes, start: int) -> bool:
    """Return whether the length of a chunk record fits the length of its data."""
    try:
        _, length = RECORD_HEAD.unpack_from(window, start)
        (name,) = struct.unpack_from("<I", window, start + _BEFORE_NAME - 4)
        (data,) = struct.unpack_from("<Q", window, start + _BEFORE_NAME + name)
    except struct.error:
        return False
    return bool(length == _BEFORE_NAME - RECORD_HEAD.size + name + 8 + data)


def _is_whole(file: InputFile, offset: int, budget: UnpackBudget) -> bool:
    try:
        head = read_chunk_head(file, offset, file.record(offset).end - offset)
        budget.spend(head.uncompressed_size + head.data_size)
        return any(True for _ in walk_records(read_chunk(file, head)))
    except BeyondLimit:
        raise
    except Damaged:
        return False


# Bags in which rosbag2 compressed each message separately (`compression_mode: message`)

SERIALIZED_METADATA: Final = "serialized_metadata"

ZSTD: Final = "zstd"
"""The compression of rosbag2's only plugin."""

# Possessive (`*+`): any text takes time in proportion to its length.
_MODE = re.compile(r"^( *+compression_mode: *+)[\"']?(\w*+)[\"']?(?= *+$)", re.MULTILINE)
_FORMAT = re.compile(r"^( *+compression_format: *+)[\"']?(\w*+)[\"']?(?= *+$)", re.MULTILINE)


def message_compression(metadata: Iterable[Metadata], path: Path) -> str:
    """Return the compression of the single messages in the file `path`, "" for none."""
    texts = [
        record.metadata.get(SERIALIZED_METADATA, "")
        for record in metadata
        if record.name == METADATA_RECORD
    ]
    for text in texts[::-1]:
        if _MODE.search(text):
            return _format_in(text)
    text = metadata_text(path)
    return _format_in(text) if path.name in files_in(text) else ""


def without_compression(values: dict[str, str]) -> dict[str, str]:
    """Return rosbag2's metadata record with an empty compression mode and format."""
    if SERIALIZED_METADATA not in values:
        return values
    text = values[SERIALIZED_METADATA]
    for pattern in (_MODE, _FORMAT):
        text = pattern.sub(r'\1""', text)
    return values | {SERIALIZED_METADATA: text}


def _format_in(text: str) -> str:
    mode, form = _MODE.search(text), _FORMAT.search(text)
    if mode is None or mode[2].lower() != "message":
        return ""
    return form[2].lower() if form else "an unknown format"


class MessageDecompressor:
    """Decompresses single messages, or those of one chunk, within the limits of a file."""

    def __init__(self, offset: int, limits: ReadLimits, tally: Tally) -> None:
        """Set up a decompressor for the place at `offset`. `tally` sums the file's costs."""
        self._offset = offset
        self._limits = limits
        self._tally = tally
        self._cost = 0
        self._zstd = ZstdDecompressor()

    def decompress(self, frame: bytes) -> bytes:
        """Return the message in a zstd frame.

        Raises:
            Damaged: The frame is corrupt, or exceeds the limits.
        """
        try:
            size, most = frame_content_size(frame), self._limits.chunk_bytes
            if size > most:
                raise BeyondLimit(f"a message claims {size} bytes, more than {most}")
            self._cost += unpacking_cost(max(size, 0))
            if self._cost > self._limits.unpacked_cost - self._tally.others(self._offset):
                raise beyond_unpacking(self._limits.unpacked_cost)
            self._tally.note(self._offset, self._cost)
            return self._zstd.decompress(frame, max_output_size=size)
        except (ZstdError, ValueError, MemoryError) as error:
            raise Damaged("messages are not compressed as the metadata says") from error
