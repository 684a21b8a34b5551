"""The chunk compressions that the reader supports; the recorder writes only some of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from io import BytesIO
from typing import Final, NamedTuple

from lz4.frame import LZ4FrameDecompressor
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.recording.format.names import Compression
from robotctl.recording.read.damage import Damaged

_PIECE_BYTES = 8 << 20


class Decompressor(NamedTuple):
    """How to undo one compression. Both functions get the stored bytes and the original size."""

    unpack: Callable[[bytes, int], bytes]
    """It raises Damaged if the data is corrupt, and MemoryError."""

    unpack_torn: Callable[[bytes, int], bytes]
    """It returns the data before the tear."""


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
"""By the name in a chunk record."""


def decompressor_of(name: str) -> Decompressor:
    """Return the decompressor of a compression.

    Raises:
        Damaged: The compression is not supported.
    """
    found = DECOMPRESSORS.get(name)
    if found is None:
        raise Damaged(f"a chunk is compressed by {name!r}, which is not supported")
    return found
