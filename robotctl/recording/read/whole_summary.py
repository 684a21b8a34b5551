"""Compares the summary of a file with what its data section holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    ChunkIndex,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from robotctl.recording.format.records import FIRST_PRIVATE_OPCODE
from robotctl.recording.format.seal_records import LINK_OPCODE
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.mcap_input import RECORD_HEAD, parse, walk_records
from robotctl.recording.read.whole_data import Flaws, WholeData


def compare_summary(summary: bytes, start: int, data: WholeData, flaws: Flaws) -> None:
    """Add a flaw for each difference between summary and data; `start` is the summary's offset.

    A summary of robotctl must list each record once. Other writers may leave some out.
    """
    comparison = _Comparison(start, data, flaws)
    try:
        for opcode, begin, end in walk_records(summary):
            comparison.record(opcode, summary[begin:end], start + begin - RECORD_HEAD.size)
    except Damaged:
        flaws.add(start, start + len(summary), "the summary cannot be read to its end")
        return
    comparison.end(start + len(summary))


class _Comparison:
    def __init__(self, start: int, data: WholeData, flaws: Flaws) -> None:
        self._data = data
        self._flaws = flaws
        self._start = start
        self._seen: dict[int, set[int]] = {}
        self._groups: dict[int, tuple[int, int]] = {}
        self._offsets_told = False
        self._readers: Mapping[int, Callable[[bytes], tuple[int, Any, Any]]] = {
            Opcode.SCHEMA: self._schema,
            Opcode.CHANNEL: self._channel,
            Opcode.METADATA_INDEX: self._metadata_index,
            Opcode.ATTACHMENT_INDEX: self._attachment_index,
            Opcode.CHUNK_INDEX: self._chunk_index,
            Opcode.STATISTICS: self._statistics,
        }

    def record(self, opcode: int, content: bytes, offset: int) -> None:
        """Compare one record of the summary, which stands at `offset`."""
        end = offset + RECORD_HEAD.size + len(content)
        if opcode == Opcode.SUMMARY_OFFSET:
            self._summary_offset(content, offset, end)
            return
        first, _ = self._groups.get(opcode, (offset, end))
        self._groups[opcode] = first, end
        read = self._readers.get(opcode)
        if read is None:
            if opcode < FIRST_PRIVATE_OPCODE or (self._data.own and opcode != LINK_OPCODE):
                self._flaws.add(offset, end, f"no record of kind {opcode} belongs into a summary")
            self._data.private_in_summary.append((opcode, content))
            return
        try:
            key, told, found = read(content)
        except Damaged as damage:
            self._flaws.add(offset, end, str(damage))
            return
        data = self._data
        seen = self._seen.setdefault(opcode, set())
        name = Opcode(opcode).name.lower().replace("_", " ")
        if key in seen:
            self._flaws.add(offset, end, f"the summary holds the same {name} twice")
        seen.add(key)
        if opcode == Opcode.STATISTICS and data.bad_chunks:
            return  # it counts what cannot be read
        if opcode == Opcode.CHUNK_INDEX and key in data.bad_chunks:
            return
        if told != found and (data.own or found is not None):
            self._flaws.add(offset, end, f"the {name} of the summary is not that of the data")

    def end(self, offset: int) -> None:
        """Add a flaw for each record that is missing; the summary ends at `offset`."""
        data = self._data
        if not data.own:
            return
        there: dict[int, set[int]] = {
            Opcode.SCHEMA: set(data.schemas),
            Opcode.CHANNEL: set(data.channels),
            Opcode.METADATA_INDEX: set(data.metadata_indexes),
            Opcode.ATTACHMENT_INDEX: set(data.attachment_indexes),
            Opcode.CHUNK_INDEX: set(data.chunk_indexes),
            Opcode.STATISTICS: {0},
        }
        for opcode, keys in there.items():
            missing = keys - self._seen.get(opcode, set())
            if missing:
                name = Opcode(opcode).name.lower().replace("_", " ")
                text = f"the summary lacks the {name} of {min(missing)}"
                self._flaws.add(self._start, offset, text)

    def _summary_offset(self, content: bytes, offset: int, end: int) -> None:
        try:
            told = parse(SummaryOffset, content)
        except Damaged as damage:
            self._flaws.add(offset, end, str(damage))
            return
        group = self._groups.get(told.group_opcode)
        is_empty = group is None and told.group_length == 0
        if is_empty and not self._data.own and self._start <= told.group_start <= offset:
            return  # the mcap library names groups without records, too
        if group != (told.group_start, told.group_start + told.group_length):
            self._flaws.add(offset, end, "a summary offset points elsewhere")

    def _schema(self, content: bytes) -> tuple[int, Any, Any]:
        key = int.from_bytes(content[:2], "little")
        return key, content, self._data.schemas.get(key)

    def _channel(self, content: bytes) -> tuple[int, Any, Any]:
        key = int.from_bytes(content[:2], "little")
        return key, content, self._data.channels.get(key)

    def _metadata_index(self, content: bytes) -> tuple[int, Any, Any]:
        told = parse(MetadataIndex, content)
        return told.offset, told, self._data.metadata_indexes.get(told.offset)

    def _attachment_index(self, content: bytes) -> tuple[int, Any, Any]:
        told = parse(AttachmentIndex, content)
        return told.offset, told, self._data.attachment_indexes.get(told.offset)

    def _chunk_index(self, content: bytes) -> tuple[int, Any, Any]:
        told = parse(ChunkIndex, content)
        return told.chunk_start_offset, told, self._data.chunk_indexes.get(told.chunk_start_offset)

    def _statistics(self, content: bytes) -> tuple[int, Any, Any]:
        data, told = self._data, parse(Statistics, content)
        found = Statistics(
            attachment_count=len(data.attachment_indexes),
            channel_count=len(data.channels),
            channel_message_counts=data.counts,
            chunk_count=len(data.chunk_indexes),
            message_count=data.message_count,
            message_end_time=data.end_ns,
            message_start_time=data.start_ns,
            metadata_count=len(data.metadata_indexes),
            schema_count=len(data.schemas),
        )
        if not data.own:  # other writers list channels without messages, too
            told.channel_message_counts = {
                channel: count for channel, count in told.channel_message_counts.items() if count
            }
        return 0, told, found
