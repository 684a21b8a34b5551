"""Reading parts of an MCAP file that may be damaged or hostile.

Whatever is wrong ends as `Damaged`; every length is checked before anything is allocated.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Final, Protocol, Self, TypeVar

from isal.isal_zlib import crc32
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import McapRecord
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.recording.storage import is_locked

RECORD_HEAD: Final = struct.Struct("<BQ")
"""opcode, length of what follows [bytes]."""

MESSAGE_FIELDS: Final = struct.Struct("<HIQQ")
"""What precedes a message's data: channel id, sequence, log time [ns], publish time [ns]."""

CHUNK_FIELDS: Final = struct.Struct("<QQQI")
"""What begins a chunk: start and end time [ns], uncompressed size [bytes], uncompressed CRC."""

MAX_RECORD_BYTES: Final = 64 << 20
"""A schema, channel, metadata or index record above this is taken for damage."""

MAX_CHUNK_BYTES: Final = 128 << 20
MAX_CHUNK_RATIO: Final = 32
"""A chunk may unpack to MAX_CHUNK_BYTES, a large one to so many times its stored size."""

_MAX_NAME_BYTES = 32
_CHUNK_PREFIX_BYTES = CHUNK_FIELDS.size + 4 + _MAX_NAME_BYTES + 8

_Record = TypeVar("_Record", bound=McapRecord, covariant=True)


class Damaged(Exception):
    """A part of the file cannot be read; the text says what is wrong, without naming the file."""


class _RecordClass(Protocol[_Record]):
    @staticmethod
    def read(stream: ReadDataStream) -> _Record: ...


class _ExactStream(ReadDataStream):
    """Refuses to return less than was asked for, as the package's own stream does."""

    def read(self, length: int) -> bytes:
        data: bytes = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(kind: _RecordClass[_Record], data: bytes) -> _Record:
    """The record whose content, without opcode and length, is `data`. Raises Damaged."""
    try:
        return kind.read(_ExactStream(BytesIO(data)))
    except (McapError, ValueError, struct.error, OverflowError, MemoryError) as error:
        raise Damaged(f"a {kind.__name__.lower()} record is malformed") from error  # type: ignore[attr-defined]


class InputFile:
    """A file that is read at positions; it may grow meanwhile."""

    def __init__(self, path: Path) -> None:
        """Open `path`, a regular file. Raises OSError."""
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        status = os.fstat(self._fd)
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        self.size = status.st_size

    def refresh(self) -> None:
        """See how large the file is by now."""
        self.size = os.fstat(self._fd).st_size

    def is_changing(self) -> bool:
        """Whether the file has another size by now, or somebody has it open for recording."""
        return os.fstat(self._fd).st_size != self.size or is_locked(self._fd)

    def read(self, offset: int, length: int) -> bytes:
        """Exactly `length` bytes at `offset`. Raises Damaged beyond the end of the file."""
        if offset < 0 or length < 0 or offset + length > self.size:
            raise Damaged(f"it ends at byte {self.size}, in the middle of a record")
        try:
            data = os.pread(self._fd, length, offset)
            while len(data) < length:
                more = os.pread(self._fd, length - len(data), offset + len(data))
                if not more:
                    raise Damaged(f"it was cut off at byte {offset + len(data)} meanwhile")
                data += more
        except OSError as error:
            raise Damaged(f"the disk cannot read it at byte {offset}: {error.strerror}") from error
        return data

    def close(self) -> None:
        """Close it; closing twice is harmless."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> Self:
        """The file itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()


@dataclass(frozen=True, slots=True)
class ChunkRef:
    """Where a chunk's data lies, and what its record says about it (times in ns)."""

    data_offset: int
    data_size: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int


def read_chunk_ref(file: InputFile, offset: int, length: int) -> ChunkRef:
    """Parse the head of the chunk record at `offset`, `length` bytes in all. Raises Damaged."""
    content = offset + RECORD_HEAD.size
    prefix = file.read(content, min(_CHUNK_PREFIX_BYTES, length - RECORD_HEAD.size))
    fields = CHUNK_FIELDS
    try:
        start_ns, end_ns, uncompressed_size, crc = fields.unpack_from(prefix)
        (name_size,) = struct.unpack_from("<I", prefix, fields.size)
        if name_size > _MAX_NAME_BYTES:
            raise Damaged("a chunk's compression has no name")
        name_end = fields.size + 4 + name_size
        compression = prefix[fields.size + 4 : name_end].decode()
        (data_size,) = struct.unpack_from("<Q", prefix, name_end)
    except (struct.error, ValueError) as error:
        raise Damaged("the head of a chunk is malformed") from error
    data_offset = content + name_end + 8
    if data_offset + data_size > offset + length:
        raise Damaged("a chunk is longer than its record")
    return ChunkRef(data_offset, data_size, compression, uncompressed_size, crc, start_ns, end_ns)


def read_chunk(file: InputFile, ref: ChunkRef) -> bytes:
    """The chunk's records, unpacked and checked. Raises Damaged."""
    _check_size(ref)
    data = _unpack(file.read(ref.data_offset, ref.data_size), ref)
    if len(data) != ref.uncompressed_size:
        raise Damaged(f"a chunk has {len(data)} bytes instead of {ref.uncompressed_size}")
    if ref.crc and crc32(data) != ref.crc:
        raise Damaged("a chunk's checksum is wrong")
    return data


def read_torn_chunk(file: InputFile, ref: ChunkRef) -> bytes:
    """What can be unpacked of a chunk that the end of the file cuts off; unchecked."""
    _check_size(ref)
    stored = file.read(ref.data_offset, max(min(ref.data_size, file.size - ref.data_offset), 0))
    if ref.compression == "":
        return stored
    data = b""
    with suppress(ZstdError, RuntimeError, ValueError, MemoryError):
        if ref.compression == "zstd":
            with ZstdDecompressor().stream_reader(BytesIO(stored)) as reader:
                while piece := reader.read(min(1 << 20, ref.uncompressed_size - len(data))):
                    data += piece
        elif ref.compression == "lz4":
            data = LZ4FrameDecompressor().decompress(stored, ref.uncompressed_size)
    return data


def _check_size(ref: ChunkRef) -> None:
    if ref.uncompressed_size > max(MAX_CHUNK_BYTES, MAX_CHUNK_RATIO * ref.data_size):
        raise Damaged(f"a chunk claims to unpack to {ref.uncompressed_size} bytes")


def _unpack(stored: bytes, ref: ChunkRef) -> bytes:
    size = ref.uncompressed_size
    try:
        if ref.compression == "":
            return stored
        if ref.compression == "zstd":
            if frame_content_size(stored) not in (-1, size):
                raise Damaged("a chunk's zstd frame has another size than its record")
            return ZstdDecompressor().decompress(stored, max_output_size=size)
        if ref.compression == "lz4":
            data: bytes = LZ4FrameDecompressor().decompress(stored, size)
            return data
    except (ZstdError, RuntimeError, ValueError, MemoryError) as error:
        raise Damaged(f"a chunk's {ref.compression} data is corrupt") from error
    raise Damaged(f"a chunk is compressed by {ref.compression!r}, which is not supported")


def walk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the content of each record in a chunk. Raises Damaged at a tear."""
    position, size = 0, len(data)
    unpack = RECORD_HEAD.unpack_from
    while position < size:
        if position + RECORD_HEAD.size > size:
            raise Damaged("a chunk ends in the middle of a record")
        opcode, length = unpack(data, position)
        position += RECORD_HEAD.size
        end = position + length
        if end > size or (opcode == Opcode.MESSAGE and length < MESSAGE_FIELDS.size):
            raise Damaged("a chunk ends in the middle of a record")
        yield opcode, position, end
        position = end
