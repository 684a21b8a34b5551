"""Where messages wait, packed as MCAP records, between the loop and the writer thread.

No lock: one thread packs, one other takes. The packer writes a message behind `end`, then its
index entry, and moves `end` last; what lies below `end` never changes until the buffer is
recycled. So the other thread may take everything below `end` at any moment. (Each of these steps
is one bytecode or one C call under the interpreter lock.)
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mcap.opcode import Opcode

from robotctl.recording.disk.storage import Buffer
from robotctl.recording.format.records import MESSAGE_FIELDS_BYTES, MESSAGE_HEAD, PlainMessage


@dataclass(frozen=True, slots=True)
class PackedMessages:
    """Messages taken from a buffer.

    `parts`, one behind the other, are the records of an uncompressed chunk; `indexes` gives for
    each channel in it an array('Q') of log time [ns] and offset in the chunk, alternating; start
    and end are the lowest and highest log time [ns].
    """

    parts: Sequence[Buffer]
    indexes: dict[int, array[int]]
    start_ns: int
    end_ns: int


class PackBuffer:
    """Room for many messages; packed by `Recorder.write`, which knows these attributes.

    `limit` is where packing must end: the packer moves on to another buffer when a message
    would pass it. The taker sets it to 0 to ask for that. `unordered` are the channels whose log
    times may step back in it: all others need not be searched for their lowest and highest.
    """

    __slots__ = ("_taken", "data", "end", "indexes", "limit", "size", "unordered")

    def __init__(self, capacity: int) -> None:
        """Make room for `capacity` bytes of records."""
        self.data = bytearray(capacity)
        self.end = 0
        self.limit = capacity
        self.indexes: list[array[int]] = []
        self.unordered: set[int] = set()
        self.size = capacity
        """Bytes of memory it holds, without those of its indexes before `weigh`."""

        self._taken = 0

    def weigh(self) -> int:
        """Add the bytes of the indexes to `size`, and return them. For the packer, at its end."""
        added = sum(len(index) * index.itemsize for index in self.indexes)
        self.size += added
        return added

    def make_indexes(self, channels: int) -> None:
        """See that there is an index for each of so many channels. For the packer."""
        while len(self.indexes) < channels:
            self.indexes.append(array("Q"))

    def take(self) -> PackedMessages | None:
        """What was packed since the last take, or None. Valid until `recycle`. For the taker.

        Raises MemoryError; then nothing is taken.
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
        """Take what was packed and throw it away: number of messages by channel. For the taker."""
        end = self.end
        counts = {channel: _entries_below(index, end) for channel, index in enumerate(self.indexes)}
        for channel, count in counts.items():
            del self.indexes[channel][:count]
        self._taken = end
        return {channel: count // 2 for channel, count in counts.items()}

    def recycle(self) -> None:
        """Make it empty again. Only after a take that nothing was packed behind."""
        self._taken = 0
        self.end = 0
        self.limit = self.size = len(self.data)
        self.unordered.clear()


class LargeMessage:
    """One message too large for a PackBuffer, kept by reference instead of copied."""

    __slots__ = ("_message",)

    def __init__(self, message: PlainMessage) -> None:
        """Keep a message whose numbers are within the fields of the format."""
        self._message = message

    @property
    def size(self) -> int:
        """Bytes of memory it holds."""
        return len(self._message[1])

    def take(self) -> PackedMessages:
        """The message as a chunk of its own. Raises MemoryError."""
        return pack([self._message])

    def drop(self) -> dict[int, int]:
        """Its channel, and 1."""
        return {self._message[0]: 1}


def _entries_below(index: array[int], end: int) -> int:
    """Numbers in the entries of messages below `end`; the packer may be adding another one."""
    count = len(index) & ~1
    while count and index[count - 1] >= end:
        count -= 2
    return count


def pack(messages: Iterable[PlainMessage]) -> PackedMessages:
    """These messages, at least one, as one chunk, without a buffer; their data is not copied."""
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
