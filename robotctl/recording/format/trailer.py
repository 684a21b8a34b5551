"""The trailer of an MCAP file: DataEnd, summary, footer and magic."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple, Self

from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, Statistics, SummaryOffset

from robotctl.recording.format.disk import Buffer
from robotctl.recording.format.records import (
    DATA_END_BYTES,
    FOOTER_CONTENT_BYTES,
    MAGIC,
    RECORD_HEAD_BYTES,
    Chunk,
    record_bytes,
)

_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.CHUNK_INDEX,
    Opcode.STATISTICS,
)
"""The groups of the summary in file order. Those that each chunk changes must come last."""

_CRC = struct.Struct("<I")
FOOTER_BYTES = RECORD_HEAD_BYTES + FOOTER_CONTENT_BYTES + len(MAGIC)
"""Size of footer and magic."""


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """What a writer needs to append to a valid file without attachments.

    `data_crc` is the checksum in the DataEnd record at `data_end`. `groups` has the summary's
    records, concatenated, by opcode.
    """

    data_end: int
    data_crc: int
    groups: Mapping[Opcode, bytes]
    statistics: Statistics
    seal: bytes = b""
    """The newest link of the seal, as a record of the summary; empty if there is none."""


@dataclass(frozen=True, slots=True)
class TrailerState:
    """A snapshot from which `Summary.trailer` can write the same trailer again."""

    data_end: int
    """The offset where the trailer begins."""

    data_crc: int
    statistics: bytes
    group_sizes: Mapping[Opcode, int]
    """Bytes of all groups but the statistics."""

    seal: bytes = b""
    """The newest link of the seal as a record; empty if there is none."""

    @property
    def kept_bytes(self) -> int:
        """Length of the trailer's beginning that stays the same when a chunk is added [bytes]."""
        return DATA_END_BYTES + sum(self.group_sizes.values())


class Trailer(NamedTuple):
    """The bytes of a file's trailer: one field for each part, in file order."""

    data_end: bytes
    """The DataEnd record."""

    summary: list[Buffer]
    """The records of the summary in file order, with that of the seal at the end."""

    offsets: bytes
    """The summary offsets."""

    footer: bytes
    """Footer and magic, FOOTER_BYTES in all."""

    @property
    def parts(self) -> list[Buffer]:
        """All parts of the trailer in file order, from DataEnd to the magic bytes."""
        return [*self.before_footer, self.footer]

    @property
    def before_footer(self) -> list[Buffer]:
        """All parts except the footer and the magic bytes, in file order."""
        return [self.data_end, *self.summary, self.offsets]

    def behind(self, position: int) -> list[Buffer]:
        """Return the bytes of the trailer from `position`, an offset in the trailer, to its end."""
        parts: list[Buffer] = []
        for part in self.parts:
            parts.append(memoryview(part)[max(position, 0) :])
            position -= len(part)
        return parts

    @property
    def size(self) -> int:
        """Size in bytes."""
        return sum(map(len, self.parts))


class Summary:
    """The summary of a file that is being written. It grows with each record."""

    def __init__(self) -> None:
        self.counts: dict[int, int] = {}
        """Messages per channel id, of channels with messages."""

        self.start_ns = 0
        """Lowest log time in the file [ns], 0 without messages."""

        self.end_ns = 0
        """Highest log time in the file [ns], 0 without messages."""

        self._groups = {opcode: bytearray() for opcode in _GROUPS}
        self._numbers: Counter[Opcode] = Counter()

    @classmethod
    def of(cls, written: WrittenFile) -> Self:
        """Return a summary that begins with the content of a finished file's summary."""
        self = cls()
        for opcode, group in self._groups.items():
            group += written.groups.get(opcode, b"")
        statistics = written.statistics
        self._numbers[Opcode.SCHEMA] = statistics.schema_count
        self._numbers[Opcode.CHANNEL] = statistics.channel_count
        self._numbers[Opcode.CHUNK_INDEX] = statistics.chunk_count
        self._numbers[Opcode.METADATA_INDEX] = statistics.metadata_count
        self.counts = dict(statistics.channel_message_counts)
        self.start_ns = statistics.message_start_time
        self.end_ns = statistics.message_end_time
        return self

    @property
    def index_bytes(self) -> int:
        """Size of the chunk index in bytes."""
        return len(self._groups[Opcode.CHUNK_INDEX])

    def group_sizes(self) -> Mapping[Opcode, int]:
        """Return the size [bytes] of each group of records, by opcode."""
        return {opcode: len(group) for opcode, group in self._groups.items()}

    def add(self, opcode: Opcode, record: bytes) -> None:
        """Append a record to the group of its opcode."""
        self._groups[opcode] += record
        self._numbers[opcode] += 1

    def count(self, chunk: Chunk) -> None:
        """Add a chunk to counts and times. Call this before the chunk's index record is added."""
        first = not self._numbers[Opcode.CHUNK_INDEX]
        self.start_ns = chunk.start_ns if first else min(self.start_ns, chunk.start_ns)
        self.end_ns = max(self.end_ns, chunk.end_ns)
        for channel, entries in chunk.indexes.items():
            self.counts[channel] = self.counts.get(channel, 0) + len(entries) // 2

    def go_back_to(self, state: TrailerState | None) -> None:
        """Restore the message counts and times of `state`, or reset them to 0 if it is None."""
        counted = None
        if state is not None:
            content = BytesIO(state.statistics[RECORD_HEAD_BYTES:])
            counted = Statistics.read(ReadDataStream(content))
        self.counts = dict(counted.channel_message_counts) if counted else {}
        self.start_ns = counted.message_start_time if counted else 0
        self.end_ns = counted.message_end_time if counted else 0

    def state(self, data_end: int, data_crc: int, seal: bytes = b"") -> TrailerState:
        """Return the current state for data that ends at `data_end` with the CRC `data_crc`."""
        statistics = Statistics(
            attachment_count=self._numbers[Opcode.ATTACHMENT_INDEX],
            channel_count=self._numbers[Opcode.CHANNEL],
            channel_message_counts=self.counts,
            chunk_count=self._numbers[Opcode.CHUNK_INDEX],
            message_count=sum(self.counts.values()),
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=self._numbers[Opcode.METADATA_INDEX],
            schema_count=self._numbers[Opcode.SCHEMA],
        )
        return TrailerState(
            data_end=data_end,
            data_crc=data_crc,
            statistics=record_bytes(statistics),
            group_sizes=self.group_sizes(),
            seal=seal,
        )

    def trailer(self, state: TrailerState) -> Trailer:
        """Return the bytes of the trailer of `state`."""
        data_end = record_bytes(DataEnd(data_section_crc=state.data_crc))
        summary_start = state.data_end + len(data_end)
        groups: list[Buffer] = []
        offsets = bytearray()
        position = summary_start
        for opcode, group in self._groups.items():
            content: Buffer = memoryview(group)[: state.group_sizes[opcode]]
            if opcode is Opcode.STATISTICS:
                content = state.statistics
            if not len(content):
                continue
            groups.append(content)
            offsets += record_bytes(SummaryOffset(opcode, position, len(content)))
            position += len(content)
        if state.seal:
            groups.append(state.seal)
            offsets += record_bytes(SummaryOffset(state.seal[0], position, len(state.seal)))
            position += len(state.seal)
        footer = record_bytes(Footer(summary_start, position, 0))[: -_CRC.size]
        crc = 0
        for part in (*groups, offsets, footer):
            crc = crc32(part, crc)
        return Trailer(data_end, groups, bytes(offsets), footer + _CRC.pack(crc) + MAGIC)
