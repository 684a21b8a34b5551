"""Keeps what a check reads out of the chunks of heavy topics.

A chunk can only be read as a whole. Where heavy topics share it, a check of the decisions would
read every image of a recording. So the messages of the evidence topics get a chunk of their own,
before the chunk with the rest. In each of the two, messages stay in the order of their arrival.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Collection, Iterable, Sequence
from typing import Final

from robotctl.recording.format.records import MESSAGE_FIELDS_BYTES, MESSAGE_HEAD, RECORD_HEAD_BYTES
from robotctl.recording.write.buffer import PackedMessages
from robotctl.recording.write.channel_state import ChannelState

HEAVY_BYTES: Final = 64 << 10
"""Fewer bytes of other topics stay with the evidence: another chunk would cost more than it
saves."""

HEAVY_RATIO: Final = 4
"""The least ratio of the other bytes to those of the evidence."""

assert MESSAGE_HEAD.size == RECORD_HEAD_BYTES + MESSAGE_FIELDS_BYTES


class EvidenceChunks:
    """Separates evidence from heavy topics; for the writer thread."""

    def __init__(self, topics: Collection[str], channels: Sequence[ChannelState]) -> None:
        """`topics` are the full names of the evidence topics; `channels` may grow."""
        self._topics = frozenset(topics)
        self._channels = channels
        self._known = 0
        self._evidence: set[int] = set()

    def separate(self, packed: PackedMessages) -> tuple[PackedMessages, ...]:
        """Return `packed`, or copies of the evidence in it and of the rest, if that is heavy.

        Raises:
            MemoryError: Nothing is changed.
        """
        if not self._topics or len(packed.parts) != 1:  # several parts are one large message
            return (packed,)
        self._learn()
        chosen = [channel for channel in packed.indexes if channel in self._evidence]
        if not chosen or len(chosen) == len(packed.indexes):
            return (packed,)
        view = memoryview(packed.parts[0])
        spans = _spans(view, (packed.indexes[channel] for channel in chosen))
        evidence_bytes = sum(end - start for start, end in spans)
        rest_bytes = len(view) - evidence_bytes
        if rest_bytes < max(HEAVY_BYTES, HEAVY_RATIO * evidence_bytes):
            return (packed,)
        others = [channel for channel in packed.indexes if channel not in self._evidence]
        gaps = _between(spans, len(view))
        return _part(view, spans, packed, chosen), _part(view, gaps, packed, others)

    def _learn(self) -> None:
        """Find the channels of the evidence topics among those that were added."""
        known = len(self._channels)
        for channel in range(self._known, known):
            if self._channels[channel].topic.name in self._topics:
                self._evidence.add(channel)
        self._known = known


_Span = tuple[int, int]
"""Start and end [bytes] of records."""


def _spans(view: memoryview, indexes: Iterable[array[int]]) -> list[_Span]:
    """Return where the records of these indexes stand, in order; neighbours are joined."""
    length = slice(1, RECORD_HEAD_BYTES)
    spans: list[_Span] = []
    for start in sorted(offset for index in indexes for offset in index[1::2]):
        size = int.from_bytes(view[start + length.start : start + length.stop], "little")
        end = start + RECORD_HEAD_BYTES + size
        if spans and spans[-1][1] == start:
            spans[-1] = spans[-1][0], end
        else:
            spans.append((start, end))
    return spans


def _between(spans: Sequence[_Span], size: int) -> list[_Span]:
    """Return the spans that are left of `size` bytes."""
    edges = [0, *(edge for span in spans for edge in span), size]
    return [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if start < end]


def _part(
    view: memoryview, spans: Sequence[_Span], packed: PackedMessages, channels: Iterable[int]
) -> PackedMessages:
    """Return the messages of `channels`, whose records stand in `spans`, one after the other."""
    starts = [start for start, _ in spans]
    shifts: list[int] = []
    size = 0
    for start, end in spans:
        shifts.append(start - size)
        size += end - start
    indexes: dict[int, array[int]] = {}
    for channel in channels:
        index = packed.indexes[channel][:]
        for place in range(1, len(index), 2):
            index[place] -= shifts[bisect_right(starts, index[place]) - 1]
        indexes[channel] = index
    times = [time_ns for index in indexes.values() for time_ns in index[::2]]
    content = b"".join(view[start:end] for start, end in spans)
    return PackedMessages([content], indexes, min(times), max(times))
