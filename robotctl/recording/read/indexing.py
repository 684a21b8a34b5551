"""Index any MCAP file from its summary or, if that is not valid, by a scan."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from operator import attrgetter

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, DataEnd, Footer, Metadata, MetadataIndex, Statistics

from robotctl.recording.format.records import (
    DATA_END_BYTES,
    FIRST_PRIVATE_OPCODE,
    FOOTER_CONTENT_BYTES,
    MAGIC,
)
from robotctl.recording.format.seal_records import LINK_OPCODE, OPENING_OPCODE
from robotctl.recording.format.trailer import FOOTER_BYTES, WrittenFile
from robotctl.recording.read.chunks import ZSTD, find_chunk, message_compression
from robotctl.recording.read.file_index import (
    Contents,
    FileIndex,
    Place,
    PlaceKind,
    read_chunk_index,
    read_chunk_times,
)
from robotctl.recording.read.read_limits import BeyondLimit, Damaged, UnpackBudget
from robotctl.recording.read.records import (
    LOST_HEADER,
    MESSAGE_FIELDS,
    RECORD_HEAD,
    TOO_MANY_RECORDS,
    ZEROS,
    InputFile,
    Record,
    parse,
    read_header,
    walk_records,
)

MAX_SUMMARY_BYTES = 256 << 20
"""Enough for about 600,000 chunks. A file with a larger summary is scanned."""

_CRC_BYTES = 4


def read_summary(file: InputFile) -> tuple[bytes, int]:
    """Return the records of the summary, with a verified checksum, and their offset in the file.

    Raises:
        Damaged: There is no valid summary.
    """
    file.refresh()  # as late as possible, since the file may be growing
    footer_offset = file.size - FOOTER_BYTES
    data = file.read(footer_offset, FOOTER_BYTES)
    if data[0] != Opcode.FOOTER or not data.endswith(MAGIC):
        raise Damaged("it has no footer")
    footer = parse(Footer, data[RECORD_HEAD.size :][:FOOTER_CONTENT_BYTES])
    start = footer.summary_start
    if start == 0:
        raise Damaged("it has no summary")
    if start > footer_offset or footer_offset - start > MAX_SUMMARY_BYTES:
        raise Damaged("its footer is corrupt")
    summary = file.read(start, footer_offset - start)
    if not footer.summary_crc:
        return _before_own_footer(summary), start
    if footer.summary_crc != crc32(data[: -len(MAGIC) - _CRC_BYTES], crc32(summary)):
        raise Damaged("its summary is corrupt")
    return summary, start


def _before_own_footer(data: bytes) -> bytes:
    """Return the summary in `data`. Its footer and an unfinished commit may follow it.

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


def index_from_summary(file: InputFile, *, places: bool = True) -> FileIndex:
    """Return the index in a file's summary. With `places=False`, it lacks the places of messages.

    Raises:
        Damaged: The summary is missing or not valid.
    """
    header, data_start = read_header(file)
    data, data_end = read_summary(file)
    index = FileIndex(header)
    statistics: Statistics | None = None
    metadata: dict[int, MetadataIndex] = {}
    chunks: list[tuple[Place, int]] = []
    times: list[tuple[int, int]] = []
    for opcode, start, end in walk_records(data):
        if opcode == Opcode.CHUNK_INDEX:
            times.append(read_chunk_times(data, start, end))
            if places:
                chunks.append(read_chunk_index(data, start, end))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            index.define(opcode, data[start:end])
        elif opcode == Opcode.METADATA_INDEX:
            entry = parse(MetadataIndex, data[start:end])
            metadata[entry.offset] = entry
        elif opcode == Opcode.ATTACHMENT_INDEX:
            index.attachments.append(parse(AttachmentIndex, data[start:end]).offset)
        elif opcode == Opcode.STATISTICS:
            statistics = parse(Statistics, data[start:end])
    if statistics is None or statistics.chunk_count != len(times):
        raise Damaged("its summary is incomplete")
    counts = statistics.channel_message_counts
    if statistics.message_count != sum(counts.values()):
        raise Damaged("its summary does not count its messages")
    if statistics.message_count and not times:
        raise Damaged("its summary does not say where its messages are")
    if not index.channels.keys() >= counts.keys():
        raise Damaged("its summary does not name all its channels")
    index.counts = dict(counts)
    _set_times(index, (statistics.message_start_time, statistics.message_end_time), times)
    index.declared_metadata = statistics.metadata_count
    index.declared_attachments = statistics.attachment_count
    index.attachments = sorted(set(index.attachments))
    if places:
        chunks.sort(key=lambda chunk: chunk[0].offset)
        index.gaps = _gaps(chunks, data_start, data_end)
        index.places = _affordable([place for place, _ in chunks], file, index)
    _read_metadata(file, index, metadata.values())
    return index


def _set_times(index: FileIndex, told: tuple[int, int], chunks: list[tuple[int, int]]) -> None:
    """Set the time range of `index` to that of the chunks, or to `told` if that is wider."""
    known = [each for each in chunks if each[0] <= each[1] and each != (0, 0)]  # others are empty
    if known:
        start_ns, end_ns = min(start for start, _ in known), max(end for _, end in known)
        # Other writers may have messages outside chunks.
        if index.own or told[0] > start_ns or told[1] < end_ns:
            told = start_ns, end_ns
    index.start_ns, index.end_ns = told


def _gaps(chunks: list[tuple[Place, int]], begin: int, data_end: int) -> list[tuple[int, int]]:
    """Return the start and end of each part of the data that is no chunk and no message index.

    Raises:
        Damaged: Chunks overlap.
    """
    gaps = []
    position = begin
    for place, end in chunks:
        if place.offset < position:
            raise Damaged("its summary lists overlapping chunks")
        if place.offset > position:
            gaps.append((position, place.offset))
        position = end
    if position > data_end:
        raise Damaged("its summary points beyond its data")
    if position < data_end:
        gaps.append((position, data_end))
    return gaps


def _affordable(places: list[Place], file: InputFile, index: FileIndex) -> list[Place]:
    """Return the first places that the limits allow to decompress, and report the rest."""
    budget = UnpackBudget(file.limits)
    for number, place in enumerate(places):
        try:
            budget.spend(place.unpacked_bytes or 0)
        except BeyondLimit as limit:
            index.miss_beyond(f"only {number} of {len(places)} chunks are read", limit)
            return places[:number]
    return places


def _read_metadata(file: InputFile, index: FileIndex, entries: Iterable[MetadataIndex]) -> None:
    """Add each metadata record to `index`; report unreadable and overlapping records."""
    room = file.size
    for entry in entries:
        try:
            record = file.record(entry.offset)
            if record.opcode != Opcode.METADATA:
                raise Damaged("there is no metadata record")
            room -= record.length
            if room < 0:
                raise Damaged("the records overlap")
            index.metadata.append(parse(Metadata, file.content(record)))
        except Damaged as damage:
            index.miss(f"metadata {entry.name[:80]!r} cannot be read: {damage}")
        else:
            index.metadata_offsets.add(entry.offset)


def read_written_file(file: InputFile) -> WrittenFile:
    """Return what a writer needs to append to a file of robotctl.

    Raises:
        Damaged: The summary is not valid, or not as robotctl writes it.
    """
    data, start = read_summary(file)
    groups: dict[Opcode, bytes] = {}
    statistics = None
    seal = b""
    for code, begin, end in walk_records(data):
        record = data[begin - RECORD_HEAD.size : end]
        if code == LINK_OPCODE:
            seal = record
        if code not in _OPCODES or code >= FIRST_PRIVATE_OPCODE:
            continue
        opcode = Opcode(code)
        groups[opcode] = groups.get(opcode, b"") + record
        if opcode is Opcode.STATISTICS:
            statistics = parse(Statistics, data[begin:end])
    last = file.record(start - DATA_END_BYTES)
    if statistics is None or statistics.attachment_count or last.opcode != Opcode.DATA_END:
        raise Damaged("its end is not as robotctl writes it")
    content = file.read(last.content, DATA_END_BYTES - RECORD_HEAD.size)
    crc = parse(DataEnd, content).data_section_crc
    return WrittenFile(last.offset, crc, groups, statistics, seal)


def find_unfinished_commit(file: InputFile, index: FileIndex, data_end: int) -> int | None:
    """Return the offset of the first record of an unfinished write, or None.

    The summary lacks such records. It gives `index` and `data_end`, the end of the data.

    Raises:
        Damaged: A record cannot be read, or a chunk in the summary follows that offset.
    """
    chunks = {place.offset for place in index.places}
    listed: dict[int, Collection[int] | None] = {
        Opcode.CHUNK: chunks,
        Opcode.METADATA: index.metadata_offsets,
        Opcode.SCHEMA: index.schemas.keys(),
        Opcode.CHANNEL: index.channels.keys(),
        **dict.fromkeys((Opcode.MESSAGE_INDEX, OPENING_OPCODE, LINK_OPCODE)),  # in no summary
    }
    _, offset = read_header(file)
    while offset < data_end:
        record = file.record(offset)
        key = offset
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            key = int.from_bytes(file.read(record.content, 2), "little")
        keys = listed.get(record.opcode, ())
        if (keys is not None and key not in keys) or record.end > data_end:
            if offset < max(chunks, default=0):
                raise Damaged("a record of another writer precedes its last chunk")
            return offset
        offset = record.end
    return None


_LOOSE_RUN_BYTES = 1 << 20
"""Messages outside chunks are indexed in runs of about this size [bytes]."""

_OPCODES = frozenset(Opcode) | frozenset(range(FIRST_PRIVATE_OPCODE, 256))


def index_by_scanning(
    file: InputFile, on_progress: Callable[[int], None] = lambda offset: None
) -> FileIndex:
    """Index the readable parts of a file. `on_progress` gets the reached offset [bytes].

    Raises:
        Damaged: Not even the header can be read.
    """
    header, offset = read_header(file)
    index = FileIndex(header, scanned=True)
    scan = _Scan(file, index, offset)
    try:
        while not scan.ended:
            try:
                scan.step()
                on_progress(scan.offset)
            except BeyondLimit:
                raise
            except Damaged as damage:
                if scan.data_ended:
                    index.miss("its end is damaged: the last messages may be lost")
                    break
                scan.skip(damage)
    except BeyondLimit as limit:
        index.miss_beyond(f"the data after byte {scan.offset} is not read", limit)
    scan.finish()
    if header is LOST_HEADER and not index.places:
        raise Damaged(ZEROS)
    return index


def read_gaps(file: InputFile, index: FileIndex) -> None:
    """Index the parts of the data in `index.gaps`, which the summary does not describe."""
    of_summary = dict(index.counts), index.start_ns, index.end_ns
    scan = _Scan(file, index)
    for start, end in index.gaps:
        scan.offset, scan.ended = start, False
        try:
            while scan.offset < end and not scan.ended:
                scan.step()
        except BeyondLimit as limit:
            index.miss_beyond(f"bytes {scan.offset} to {end} are not read", limit)
        except Damaged as damage:
            index.miss(f"bytes {scan.offset} to {end} are lost: {damage}")
    scan.finish()
    index.places.sort(key=attrgetter("offset"))
    index.attachments.sort()
    index.counts, index.start_ns, index.end_ns = of_summary


class _Scan:
    """Walks a file from `offset` on, and adds the findings to the index.

    `ended` becomes True at the end of the file, `data_ended` at the end of the data section.
    """

    def __init__(self, file: InputFile, index: FileIndex, offset: int = 0) -> None:
        self._file = file
        self._index = index
        self._budget = UnpackBudget(file.limits)
        self._records = 0
        self._definitions: dict[tuple[int, int], bytes] = {}
        self._loose = (0, 0)  # start and end of a run of messages
        self._counted = 0
        self._attachments = frozenset(index.attachments)
        self.offset = offset
        self.ended = False
        self.data_ended = False

    def step(self) -> None:
        """Read the record at `offset`, and move `offset` behind the record.

        Raises:
            Damaged: There is no valid record; `offset` stays.
        """
        file, index = self._file, self._index
        if self.offset == file.size and not self.data_ended:
            index.miss("it was never finished: messages that its writer still held are lost")
            self.ended = True
            return
        record = file.record(self.offset)
        opcode = record.opcode
        if opcode not in _OPCODES:
            raise Damaged("they are not MCAP records" if opcode else "they are zeros")
        self._records += 1
        if self._records > file.limits.records:
            raise BeyondLimit(TOO_MANY_RECORDS)
        if opcode == Opcode.CHUNK:
            self.data_ended = False
            self._chunk(record)
        elif record.end > file.size:
            raise Damaged("the file ends in the middle of a record")
        elif opcode == Opcode.FOOTER:
            if not self.data_ended or record.end + len(MAGIC) < file.size:
                raise Damaged("they are not MCAP records")
            self.ended = True
            return
        elif opcode == Opcode.MESSAGE:
            if index.own or record.length < MESSAGE_FIELDS.size:  # robotctl writes only chunks
                raise Damaged("they are not MCAP records")
            self._message(record)
        elif opcode == Opcode.METADATA:
            if record.offset not in index.metadata_offsets:
                index.metadata.append(parse(Metadata, file.content(record)))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(opcode, file.content(record))
        elif opcode == Opcode.ATTACHMENT:
            if record.offset not in self._attachments:
                index.attachments.append(record.offset)
        elif opcode == Opcode.DATA_END:
            self.data_ended = True
        elif opcode == Opcode.STATISTICS:
            self._counted = parse(Statistics, file.content(record)).message_count
        self.offset = record.end

    def skip(self, damage: Damaged) -> None:
        """Move to the next chunk or the end of the file, and report the lost bytes.

        Raises:
            BeyondLimit: The search would cost too much.
        """
        found = find_chunk(self._file, self.offset + 1, self._budget)
        end = self._file.size if found is None else found
        self._index.miss(f"bytes {self.offset} to {end} are lost: {damage}")
        self.offset, self.ended = end, found is None

    def finish(self) -> None:
        """Add the last run of messages outside chunks, and report lost messages."""
        self._end_loose_run()
        index = self._index
        for channel in index.counts.keys() - index.channels.keys():
            count = index.counts.pop(channel)
            index.miss(f"{count} messages are lost: no record describes their channel")
        if not index.missing and self._counted > index.message_count:
            index.miss(f"its summary counts {self._counted} messages")

    def _chunk(self, record: Record) -> None:
        if record.end <= self._file.size:
            try:
                self._add(PlaceKind.CHUNK, record.offset, record.end)
            except BeyondLimit:
                raise
            except Damaged as damage:
                self._index.miss(f"bytes {record.offset} to {record.end} are lost: {damage}")
            return
        # A writer that only appends leaves the beginning of its chunk. robotctl overwrites its
        # trailer, so bytes of the old trailer may follow the beginning of the chunk.
        if not self._index.own:
            self._add(PlaceKind.TORN_CHUNK, record.offset, record.end)
        raise Damaged("the file ends in the middle of a chunk")

    def _message(self, record: Record) -> None:
        start, end = self._loose
        if record.offset != end or record.end - start > _LOOSE_RUN_BYTES:
            self._end_loose_run()
            start = record.offset
        self._loose = start, record.end

    def _end_loose_run(self) -> None:
        (start, end), self._loose = self._loose, (0, 0)
        if end > start:
            self._add(PlaceKind.LOOSE, start, end)

    def _add(self, kind: PlaceKind, offset: int, end: int) -> None:
        """Add the place at `offset` if it has messages, and count them.

        Raises:
            Damaged: The place cannot be read.
        """
        place = Place(kind, offset, end - offset, 0, 0, None)
        most = sys.maxsize  # `step` has counted the records of a loose run
        if kind is not PlaceKind.LOOSE:
            self._budget.spend(place.size_in_memory(self._file))
            most = self._file.limits.records - self._records
        data = place.read(self._file)
        found = Contents()
        definitions: list[tuple[int, bytes]] = []
        try:
            found.walk(data, most, lambda *record: definitions.append(record))
        except Damaged as damage:
            if kind is not PlaceKind.TORN_CHUNK or isinstance(damage, BeyondLimit):
                raise
        finally:
            if kind is not PlaceKind.LOOSE:
                self._records += found.records
        for opcode, content in definitions:
            self._define(opcode, content)
        if found.entries:
            start_ns, end_ns = found.window()
            self._index.count(found.counts, start_ns, end_ns)
            channels = frozenset(found.entries)
            self._index.places.append(
                replace(place, start_ns=start_ns, end_ns=end_ns, channels=channels)
            )

    def _define(self, opcode: int, content: bytes) -> None:
        known = opcode, int.from_bytes(content[:2], "little")
        if self._definitions.get(known) != content:  # some writers repeat it in each chunk
            self._definitions[known] = content
            self._index.define(opcode, content)


_GROWING_S = 2.0
"""Time of retries to read a growing file, before a scan."""

_LOOK_AGAIN_S = 0.002


def index_of(
    file: InputFile,
    on_progress: Callable[[int], None] = lambda offset: None,
    *,
    places: bool = True,
) -> FileIndex:
    """Return the index of a file from its summary or, if that is not valid, from a scan.

    `on_progress` gets the offset that a scan has reached. With `places=False` the index may lack
    the places of messages, which then cannot be read.

    Raises:
        Damaged: Not even the header can be read.
    """
    deadline = time.monotonic() + _GROWING_S
    while True:
        file.refresh()
        try:
            index = index_from_summary(file, places=places)
            if places:
                _complete(file, index)
            break
        except Damaged:
            if not file.is_changing() or time.monotonic() > deadline:
                index = index_by_scanning(file, on_progress)
                break
        time.sleep(_LOOK_AGAIN_S)  # a writer may be interrupted within a write
    index.message_compression = message_compression(index.metadata, file.path)
    if index.message_compression not in ("", ZSTD):
        index.places = []
        index.miss(
            f"its messages are compressed with {index.message_compression[:40]}, one by one: "
            "this is not supported"
        )
    return index


def _complete(file: InputFile, index: FileIndex) -> None:
    """Find records that the summary does not list, and report missing ones."""
    # A summary of robotctl lists all records: its gaps have only the rest of a killed commit.
    if not index.own or index.declared_metadata > len(index.metadata):
        read_gaps(file, index)
    for told, found, noun in (
        (index.declared_attachments, len(index.attachments), "attachments"),
        (index.declared_metadata, len(index.metadata), "metadata records"),
    ):
        if told > found and not index.missing:
            index.miss(f"its summary counts {told} {noun}, and {found} are there")
