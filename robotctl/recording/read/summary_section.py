"""Reads the index of a file from its summary, in milliseconds for a file of any size."""

from __future__ import annotations

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from robotctl.recording.format.records import DATA_END_BYTES, FOOTER_CONTENT_BYTES, MAGIC
from robotctl.recording.format.seal_records import LINK_OPCODE
from robotctl.recording.format.trailer import WrittenFile
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.file_index import (
    LOST_HEADER,
    ChunkEntry,
    FileIndex,
    Place,
    ZeroedHeader,
    read_chunk_index,
    read_content,
    read_header,
    read_record_head,
)
from robotctl.recording.read.mcap_input import RECORD_HEAD, InputFile, parse, walk_records
from robotctl.recording.read.stored_chunk import UnpackBudget

MAX_SUMMARY_BYTES = 256 << 20
"""Enough for about 600,000 chunks. A larger summary counts as damage; the file is then scanned."""

_OPCODES = frozenset(Opcode)
_FOOTER_BYTES = RECORD_HEAD.size + FOOTER_CONTENT_BYTES
_CRC_BYTES = 4


def index_from_summary(file: InputFile, *, places: bool = True) -> FileIndex:
    """Return the index that the file's summary gives.

    Without `places`, this takes a fraction of the time, but messages cannot be read with the index.

    Raises:
        Damaged: The summary is missing or not valid.
    """
    try:
        header, data_start = read_header(file)
    except ZeroedHeader:
        header, data_start = LOST_HEADER
    data, data_end = _read_summary(file)
    index = FileIndex(profile=header.profile, library=header.library)
    statistics: Statistics | None = None
    metadata: list[MetadataIndex] = []
    chunks: list[ChunkEntry] = []
    chunk_count = 0
    for opcode, start, end in walk_records(data):
        if opcode == Opcode.CHUNK_INDEX:
            chunk_count += 1
            if places:
                chunks.append(read_chunk_index(data, start, end))
        elif opcode == Opcode.SCHEMA:
            schema = parse(Schema, data[start:end])
            index.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse(Channel, data[start:end])
            index.channels[channel.id] = channel
        elif opcode == Opcode.METADATA_INDEX:
            metadata.append(parse(MetadataIndex, data[start:end]))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            index.attachments.append(parse(AttachmentIndex, data[start:end]).offset)
        elif opcode == Opcode.STATISTICS:
            statistics = parse(Statistics, data[start:end])
    if statistics is None or statistics.chunk_count != chunk_count:
        raise Damaged("its summary is incomplete")
    if statistics.message_count != sum(statistics.channel_message_counts.values()):
        raise Damaged("its summary does not count its messages")
    if statistics.message_count and not chunk_count:
        raise Damaged("its summary does not say where its messages are")
    if not index.channels.keys() >= statistics.channel_message_counts.keys():
        raise Damaged("its summary does not name all its channels")
    index.counts = dict(statistics.channel_message_counts)
    index.start_ns = statistics.message_start_time
    index.end_ns = statistics.message_end_time
    index.declared_metadata = statistics.metadata_count
    index.declared_attachments = statistics.attachment_count
    index.attachments = sorted(set(index.attachments))
    if places:
        chunks.sort(key=lambda chunk: chunk.place.offset)
        index.gaps = _gaps(chunks, data_start, data_end)
        index.places = _affordable([chunk.place for chunk in chunks], file, index)
    _read_metadata(file, index, metadata)
    return index


def read_written_file(file: InputFile) -> WrittenFile:
    """Return what is needed to continue the file.

    Raises:
        Damaged: Its summary is not valid, or not as robotctl writes it.
    """
    data, start = _read_summary(file)
    groups: dict[Opcode, bytes] = {}
    statistics = None
    seal = b""
    for code, begin, end in walk_records(data):
        record = data[begin - RECORD_HEAD.size : end]
        if code == LINK_OPCODE:
            seal = record
        if code not in _OPCODES:  # a private record
            continue
        opcode = Opcode(code)
        groups[opcode] = groups.get(opcode, b"") + record
        if opcode is Opcode.STATISTICS:
            statistics = parse(Statistics, data[begin:end])
    data_end = start - DATA_END_BYTES
    opcode_before, _ = read_record_head(file, data_end)
    if statistics is None or statistics.attachment_count or opcode_before != Opcode.DATA_END:
        raise Damaged("its end is not as robotctl writes it")
    crc = parse(DataEnd, read_content(file, data_end, DATA_END_BYTES - RECORD_HEAD.size))
    return WrittenFile(data_end, crc.data_section_crc, groups, statistics, seal)


def _read_summary(file: InputFile) -> tuple[bytes, int]:
    """Return the checked summary records, and the offset where they begin."""
    file.refresh()  # as late as possible, since the file may be growing
    tail = _FOOTER_BYTES + len(MAGIC)
    footer_offset = file.size - tail
    data = file.read(footer_offset, tail)
    opcode, _ = RECORD_HEAD.unpack_from(data)
    if opcode != Opcode.FOOTER or not data.endswith(MAGIC):
        raise Damaged("it has no footer")
    footer = parse(Footer, data[RECORD_HEAD.size : _FOOTER_BYTES])
    start = footer.summary_start
    if start == 0:
        raise Damaged("it has no summary")
    if start > footer_offset or footer_offset - start > MAX_SUMMARY_BYTES:
        raise Damaged("its footer is corrupt")
    summary = file.read(start, footer_offset - start)
    covered = data[: _FOOTER_BYTES - _CRC_BYTES]
    if footer.summary_crc and footer.summary_crc != crc32(covered, crc32(summary)):
        raise Damaged("its summary is corrupt")
    if not footer.summary_crc:
        summary = _before_own_footer(summary)
    return summary, start


def _before_own_footer(data: bytes) -> bytes:
    """Return the summary at the beginning of `data`: all before the first footer, or everything.

    A footer in `data` is that of the summary; after it follows a commit that was not finished.

    Raises:
        Damaged: The footer does not belong to the summary.
    """
    for opcode, start, end in walk_records(data):
        if opcode == Opcode.FOOTER:
            footer = parse(Footer, data[start:end])
            if footer.summary_crc != crc32(data[: end - _CRC_BYTES]):
                raise Damaged("its summary is corrupt")
            return data[: start - RECORD_HEAD.size]
    return data


def _gaps(chunks: list[ChunkEntry], data_start: int, data_end: int) -> list[tuple[int, int]]:
    """Return the start and end of each part of the data that is no chunk and no message index.

    Raises:
        Damaged: Chunks overlap.
    """
    gaps = []
    position = data_start
    for chunk in chunks:
        if chunk.place.offset < position:
            raise Damaged("its summary lists overlapping chunks")
        if chunk.place.offset > position:
            gaps.append((position, chunk.place.offset))
        position = chunk.end
    if position > data_end:
        raise Damaged("its summary points beyond its data")
    if position < data_end:
        gaps.append((position, data_end))
    return gaps


def _affordable(places: list[Place], file: InputFile, index: FileIndex) -> list[Place]:
    """Return the first places, as many as the limits allow to decompress; report the others."""
    budget = UnpackBudget(file.limits)
    for number, place in enumerate(places):
        try:
            budget.spend(place.unpacked_bytes or 0)
        except BeyondLimit as limit:
            index.miss_beyond(f"only {number} of {len(places)} chunks are read", limit)
            return places[:number]
    return places


def _read_metadata(file: InputFile, index: FileIndex, entries: list[MetadataIndex]) -> None:
    """Add each metadata record to `index` once; report those that cannot be read or overlap."""
    room = file.size
    for entry in {entry.offset: entry for entry in entries}.values():
        try:
            opcode, length = read_record_head(file, entry.offset)
            if opcode != Opcode.METADATA:
                raise Damaged("there is no metadata record")
            room -= length
            if room < 0:
                raise Damaged("the records overlap")
            record = parse(Metadata, read_content(file, entry.offset, length))
        except Damaged as damage:
            index.miss(f"metadata {entry.name[:80]!r} cannot be read: {damage}")
        else:
            index.metadata.append(record)
            index.metadata_offsets.add(entry.offset)
