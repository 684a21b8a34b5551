"""Checks a chunk and the message indexes behind it, every byte."""

from __future__ import annotations

from array import array

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from robotctl.recording.format.records import Chunk, place
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.flaws import Flaws
from robotctl.recording.read.mcap_input import (
    RECORD_HEAD,
    InputFile,
    head_blocks,
)
from robotctl.recording.read.stored_chunk import (
    ChunkRef,
    UnpackBudget,
    read_chunk,
    read_chunk_ref,
)
from robotctl.recording.read.whole_data import WholeData

_INDEX_HEAD_BYTES = 6
"""Channel id and length of the entries, at the beginning of a message index."""


class WholeChunks:
    """The chunks of one file, read in their order."""

    def __init__(self, file: InputFile, data: WholeData, flaws: Flaws) -> None:
        self._file = file
        self._data = data
        self._flaws = flaws
        self._budget = UnpackBudget(file.limits)
        self._entry: ChunkIndex | None = None
        self._skip = False
        self._expected: dict[int, bytes] = {}
        """The entries of the message indexes that must follow the last chunk, by channel."""

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
        """Check the message index at `offset`, which has this content."""
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
        """Return the beginning of a message index.

        Raises:
            Damaged: The channel is not known.
        """
        if channel not in self._data.channels:
            raise Damaged(f"a chunk holds messages of channel {channel}, without a topic")
        return []


def _sorted(entries: bytes) -> list[tuple[int, int]]:
    """Return the entries of a message index in their order: writers may sort them by time."""
    values = array("Q", entries[: len(entries) // 16 * 16])
    return sorted(zip(values[::2], values[1::2], strict=True))
