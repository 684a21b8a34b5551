"""Turning packed messages into what a chunk record holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_never

from isal.isal_zlib import crc32
from zstandard import ZstdCompressionParameters, ZstdCompressor, ZstdError

from robotctl.recording.disk.storage import Buffer
from robotctl.recording.format.compression import Compression
from robotctl.recording.format.records import Chunk
from robotctl.recording.write.buffer import PackedMessages

_CACHED = {"window_log": 18, "hash_log": 13}
"""Tables that fit into the nearest caches: on odometry a third faster, and no larger."""

JOINED_BYTES = 8 << 20
"""Two parts of so many bytes are copied into one piece: zstd takes a tenth longer for a stream."""


class OutOfMemory(MemoryError):
    """There was no memory to encode a chunk. Nothing was written, and the next one may succeed."""


class ChunkEncoder:
    """Compresses and sums up. Not thread-safe; the work itself releases the interpreter lock."""

    def __init__(self, compression: Compression, level: int) -> None:
        """`level` is zstd's own; it means nothing without compression."""
        self._compression = compression
        parameters = ZstdCompressionParameters.from_level(level, **_CACHED if level == 1 else {})
        self._compressor = ZstdCompressor(compression_params=parameters)

    def encode(self, packed: PackedMessages) -> Chunk:
        """The chunk of these messages, of which there is at least one. Raises OutOfMemory."""
        try:
            return self._encode(packed)
        except (MemoryError, ZstdError) as error:  # zstd gives no other while it compresses
            raise OutOfMemory("no memory to compress messages") from error

    def _encode(self, packed: PackedMessages) -> Chunk:
        crc = 0
        for part in packed.parts:
            crc = crc32(part, crc)
        size = sum(map(len, packed.parts))
        return Chunk(
            parts=self._stored(packed.parts, size),
            compression=self._compression.mcap_name,
            uncompressed_size=size,
            uncompressed_crc=crc,
            start_ns=packed.start_ns,
            end_ns=packed.end_ns,
            indexes=packed.indexes,
        )

    def _stored(self, parts: Sequence[Buffer], size: int) -> Sequence[Buffer]:
        match self._compression:
            case Compression.NONE:
                return parts
            case Compression.ZSTD:
                return self._zstd(parts, size)
            case _:
                assert_never(self._compression)

    def _zstd(self, parts: Sequence[Buffer], size: int) -> Sequence[Buffer]:
        if len(parts) == 1:
            return [self._compressor.compress(parts[0])]
        if len(parts) > 2 or size <= JOINED_BYTES:
            return [self._compressor.compress(b"".join(parts))]
        stream = self._compressor.compressobj(size=size)
        return [*(stream.compress(part) for part in parts), stream.flush()]
