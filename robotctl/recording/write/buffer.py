"""Buffers of packed MCAP records between the event loop and the writer thread."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import assert_never

import lz4.frame
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from zstandard import ZstdCompressionParameters, ZstdCompressor, ZstdError

from robotctl.recording.format.disk import Buffer
from robotctl.recording.format.names import Compression
from robotctl.recording.format.records import (
    MESSAGE_FIELDS_BYTES,
    MESSAGE_HEAD,
    Chunk,
    PlainMessage,
)


@dataclass(frozen=True, slots=True)
class PackedMessages:
    """The content of a chunk before compression: message records, their index and time span."""

    parts: Sequence[Buffer]
    indexes: dict[int, array[int]]
    start_ns: int
    end_ns: int


class PackBuffer:
    """Memory that the event loop fills with message records, for the writer thread.

    A record must end at byte `limit` or before. With `limit` 0, the event loop continues in another
    buffer. `unordered` has the ids of channels whose log times may step back.
    """

    # There is no lock: `Recorder.write` writes a message at `end`, then its index entry, and
    # increases `end` last. Data below `end` does not change before `recycle`. Each step is one
    # bytecode or one C call, and therefore atomic under the interpreter lock.
    __slots__ = ("_taken", "data", "end", "indexes", "limit", "size", "unordered")

    def __init__(self, capacity: int) -> None:
        """Allocate `capacity` bytes for records."""
        self.data = bytearray(capacity)
        self.end = 0
        self.limit = capacity
        self.indexes: list[array[int]] = []
        self.unordered: set[int] = set()
        self.size = capacity
        """Bytes of memory in use, with the indexes only after `weigh`."""

        self._taken = 0

    def weigh(self) -> int:
        """Add the bytes of the indexes to `size`, and return them. Call it for a full buffer."""
        added = sum(len(index) * index.itemsize for index in self.indexes)
        self.size += added
        return added

    def make_indexes(self, channels: int) -> None:
        """Create indexes for channels 0 to `channels` - 1. Called by the packer."""
        while len(self.indexes) < channels:
            self.indexes.append(array("Q"))

    def take(self) -> PackedMessages | None:
        """Return the messages added since the last call, or None. Called by the writer thread.

        Raises:
            MemoryError: There is no memory; nothing is taken.
        """
        base, end = self._taken, self.end
        if base == end:
            return None
        packed: dict[int, array[int]] = {}
        starts, ends = [], []
        for channel, index in enumerate(self.indexes):
            count = _entries_below(index, end)
            if not count:
                continue
            entries = index[:count]
            if base:
                for position in range(1, count, 2):
                    entries[position] -= base
            packed[channel] = entries
            ordered = channel not in self.unordered
            starts.append(entries[0] if ordered else min(entries[::2]))
            ends.append(entries[-2] if ordered else max(entries[::2]))
        result = PackedMessages([memoryview(self.data)[base:end]], packed, min(starts), max(ends))
        for channel, entries in packed.items():
            del self.indexes[channel][: len(entries)]
        self._taken = end
        return result

    def drop(self) -> dict[int, int]:
        """Discard the messages that were not taken, and return their counts by channel."""
        end = self.end
        counts = {channel: _entries_below(index, end) for channel, index in enumerate(self.indexes)}
        for channel, count in counts.items():
            del self.indexes[channel][:count]
        self._taken = end
        return {channel: count // 2 for channel, count in counts.items()}

    def recycle(self) -> None:
        """Empty the buffer for reuse. What `take` has returned becomes invalid."""
        self._taken = 0
        self.end = 0
        self.limit = self.size = len(self.data)
        self.unordered.clear()


class LargeMessage:
    """One message too large for a PackBuffer, kept by reference."""

    __slots__ = ("_message",)

    def __init__(self, message: PlainMessage) -> None:
        """Keep `message`. Its numbers must fit the fields of the format."""
        self._message = message

    @property
    def size(self) -> int:
        """Bytes of memory in use."""
        return len(self._message[1])

    def take(self) -> PackedMessages:
        """Return the message as a chunk of its own.

        Raises:
            MemoryError: There is no memory for the chunk.
        """
        return pack([self._message])

    def drop(self) -> dict[int, int]:
        """Discard the message, and return its count by channel."""
        return {self._message[0]: 1}


def _entries_below(index: array[int], end: int) -> int:
    """Return the number of items of `index` for data below `end`; the packer may add more."""
    count = len(index) & ~1
    while count and index[count - 1] >= end:
        count -= 2
    return count


def pack(messages: Iterable[PlainMessage]) -> PackedMessages:
    """Return one or more messages as the records of one chunk. The data is not copied."""
    parts: list[Buffer] = []
    indexes: dict[int, array[int]] = {}
    times: list[int] = []
    offset = 0
    for channel, data, log_ns, publish_ns, sequence in messages:
        length = MESSAGE_FIELDS_BYTES + len(data)
        parts.append(
            MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, sequence, log_ns, publish_ns)
        )
        parts.append(data)
        indexes.setdefault(channel, array("Q")).extend((log_ns, offset))
        times.append(log_ns)
        offset += MESSAGE_HEAD.size + len(data)
    return PackedMessages(parts, indexes, min(times), max(times))


_CACHED = {"window_log": 18, "hash_log": 13}
"""Sizes of zstd's tables for the L1 and L2 caches. A third faster, and as small."""

JOINED_BYTES = 8 << 20
"""Larger pairs of parts are compressed as a stream, 10 % slower than joined parts."""


class OutOfMemory(MemoryError):
    """No memory to encode a chunk. Nothing was written, and the next chunk may succeed."""


class ChunkEncoder:
    """Compresses chunks and computes checksums. Not thread-safe. Releases the interpreter lock."""

    def __init__(self, compression: Compression, level: int) -> None:
        """Set up the compressor. `level` is that of zstd."""
        self._compression = compression
        parameters = ZstdCompressionParameters.from_level(level, **_CACHED if level == 1 else {})
        self._compressor = ZstdCompressor(compression_params=parameters)

    def encode(self, packed: PackedMessages) -> Chunk:
        """Return the messages as one chunk.

        Raises:
            OutOfMemory: There is no memory to compress the messages.
        """
        try:
            return self._encode(packed)
        except (MemoryError, ZstdError) as error:  # zstd has no other error while compressing
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
            case Compression.LZ4:
                return [lz4.frame.compress(b"".join(parts))]
            case _:
                assert_never(self._compression)

    def _zstd(self, parts: Sequence[Buffer], size: int) -> Sequence[Buffer]:
        if len(parts) == 1:
            return [self._compressor.compress(parts[0])]
        if len(parts) > 2 or size <= JOINED_BYTES:
            return [self._compressor.compress(b"".join(parts))]
        stream = self._compressor.compressobj(size=size)
        return [*(stream.compress(part) for part in parts), stream.flush()]
