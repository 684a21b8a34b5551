"""The index of any MCAP file: from its summary if there is a valid one, else by a scan."""

from __future__ import annotations

import re
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import replace

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics

from robotctl.recording.format.names import OWN_LIBRARY
from robotctl.recording.format.records import FIRST_PRIVATE_OPCODE, MAGIC
from robotctl.recording.read.compressed_messages import ZSTD, message_compression
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.file_index import (
    LOST_HEADER,
    FileIndex,
    Place,
    PlaceKind,
    ZeroedHeader,
    read_content,
    read_header,
    read_record_head,
)
from robotctl.recording.read.mcap_input import (
    MESSAGE_FIELDS,
    RECORD_HEAD,
    TOO_MANY_RECORDS,
    InputFile,
    parse,
    walk_records,
)
from robotctl.recording.read.stored_chunk import (
    DECOMPRESSORS,
    UnpackBudget,
    read_chunk,
    read_chunk_ref,
)
from robotctl.recording.read.summary_section import index_from_summary

_WINDOW_BYTES = 4 << 20
_COMPRESSIONS = [struct.pack("<I", len(name)) + name.encode() for name in DECOMPRESSORS]
_HEAD = re.compile(
    rb"\x06(?=.{8}.{28}(?:%b))" % b"|".join(map(re.escape, _COMPRESSIONS)), re.DOTALL
)
"""The opcode of a chunk, followed by lengths, times, sizes and a known compression."""

_NAME_OFFSET = RECORD_HEAD.size + 28
_HEAD_BYTES = _NAME_OFFSET + max(map(len, _COMPRESSIONS)) + 8
"""The maximum length of a chunk's fields before its data, from the opcode on [bytes]."""


def find_chunk(file: InputFile, offset: int, budget: UnpackBudget) -> int | None:
    """Return the offset of the first valid chunk at or after `offset`, or None.

    Raises:
        BeyondLimit: The search would cost more than `budget`.
    """
    while offset < file.size:
        window = file.read(offset, min(_WINDOW_BYTES + _HEAD_BYTES, file.size - offset))
        for match in _HEAD.finditer(window):
            at = offset + match.start()
            if _lengths_agree(window, match.start()) and _is_whole(file, at, budget):
                return at
        offset += _WINDOW_BYTES
    return None


def _lengths_agree(window: bytes, start: int) -> bool:
    """Return whether the length of a chunk record fits the length of its data."""
    try:
        _, length = RECORD_HEAD.unpack_from(window, start)
        (name,) = struct.unpack_from("<I", window, start + _NAME_OFFSET)
        (data,) = struct.unpack_from("<Q", window, start + _NAME_OFFSET + 4 + name)
    except struct.error:
        return False
    return bool(length == _NAME_OFFSET - RECORD_HEAD.size + 4 + name + 8 + data)


def _is_whole(file: InputFile, offset: int, budget: UnpackBudget) -> bool:
    try:
        _, length = RECORD_HEAD.unpack(file.read(offset, RECORD_HEAD.size))
        ref = read_chunk_ref(file, offset, RECORD_HEAD.size + length)
        budget.spend(ref.uncompressed_size + ref.data_size)
        return any(True for _ in walk_records(read_chunk(file, ref)))
    except BeyondLimit:
        raise
    except Damaged:
        return False


_LOOSE_RUN_BYTES = 1 << 20
"""Messages outside chunks are grouped into places of about this size."""

_OPCODES = frozenset(Opcode) | frozenset(range(FIRST_PRIVATE_OPCODE, 256))


def index_by_scanning(
    file: InputFile, on_progress: Callable[[int], None] = lambda offset: None
) -> FileIndex:
    """Index the readable parts of a file. `on_progress` gets the offset [bytes] that was reached.

    Raises:
        Damaged: Not even the header can be read.
    """
    try:
        header, offset = read_header(file)
    except ZeroedHeader:
        header, offset = LOST_HEADER
    index = FileIndex(profile=header.profile, library=header.library, scanned=True)
    scan = _Scan(file, index)
    while True:
        try:
            while scan.step(offset):
                offset = scan.next_offset
                on_progress(offset)
            break
        except BeyondLimit as limit:
            index.miss_beyond(f"the data after byte {offset} is not read", limit)
            break
        except Damaged as damage:
            if scan.data_ended:
                index.miss("its end is damaged: the last messages may be lost")
                break
            try:
                found = find_chunk(file, offset + 1, scan.budget)
            except BeyondLimit as limit:
                index.miss_beyond(f"the data after byte {offset} is not read", limit)
                break
            end = file.size if found is None else found
            index.miss(f"bytes {offset} to {end} are lost: {damage}")
            if found is None:
                break
            offset = found
    scan.finish()
    if header is LOST_HEADER[0] and not index.places:
        raise ZeroedHeader
    return index


def read_gaps(file: InputFile, index: FileIndex) -> None:
    """Add what is in the gaps of the summary: records and loose messages that it does not list."""
    counts, start_ns, end_ns = dict(index.counts), index.start_ns, index.end_ns
    scan = _Scan(file, index)
    for start, end in index.gaps:
        offset = start
        try:
            while offset < end and scan.step(offset):
                offset = scan.next_offset
        except BeyondLimit as limit:
            index.miss_beyond(f"bytes {offset} to {end} are not read", limit)
        except Damaged as damage:
            index.miss(f"bytes {offset} to {end} are lost: {damage}")
    scan.finish()
    index.places.sort(key=lambda place: place.offset)
    index.attachments.sort()
    index.counts, index.start_ns, index.end_ns = (
        counts,
        start_ns,
        end_ns,
    )  # keep those of the summary


class _Scan:
    def __init__(self, file: InputFile, index: FileIndex) -> None:
        self._file = file
        self._index = index
        self.budget = UnpackBudget(file.limits)
        self._records = 0
        self._definitions: dict[tuple[int, int], bytes] = {}
        self._loose_start = 0
        self._loose_end = 0
        self._empty = True
        self._counted = 0
        self._attachments = frozenset(index.attachments)
        self.next_offset = 0
        self.data_ended = False
        self.own = index.library.startswith(OWN_LIBRARY)

    def step(self, offset: int) -> bool:
        """Read the record at `offset`; return False at the end.

        Raises:
            Damaged: There is no valid record.
        """
        file, index = self._file, self._index
        if offset == file.size and not self.data_ended:
            index.miss("it was never finished: messages that its writer still held are lost")
            return False
        opcode, length = read_record_head(file, offset)
        if opcode not in _OPCODES:
            raise Damaged("they are not MCAP records" if opcode else "they are zeros")
        self._records += 1
        if self._records > file.limits.records:
            raise BeyondLimit(TOO_MANY_RECORDS)
        self.next_offset = end = offset + RECORD_HEAD.size + length
        if opcode == Opcode.CHUNK:
            self.data_ended = False
            self._chunk(offset, end)
        elif end > file.size:
            raise Damaged("the file ends in the middle of a record")
        elif opcode == Opcode.FOOTER:
            if not self.data_ended or end + len(MAGIC) < file.size:
                raise Damaged("they are not MCAP records")
            return False
        elif opcode == Opcode.MESSAGE:
            if self.own or length < MESSAGE_FIELDS.size:  # robotctl writes only chunks
                raise Damaged("they are not MCAP records")
            self._loose(offset, end)
        elif opcode == Opcode.METADATA:
            if offset not in index.metadata_offsets:
                index.metadata.append(parse(Metadata, read_content(file, offset, length)))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(opcode, read_content(file, offset, length))
        elif opcode == Opcode.ATTACHMENT:
            if offset not in self._attachments:
                index.attachments.append(offset)
        elif opcode == Opcode.DATA_END:
            self.data_ended = True
        elif opcode == Opcode.STATISTICS:
            statistics = parse(Statistics, read_content(file, offset, length))
            self._counted = statistics.message_count
        return True

    def finish(self) -> None:
        """Add the last loose run, and report messages that have no channel or are missing."""
        self._end_loose_run()
        for channel in self._index.counts.keys() - self._index.channels.keys():
            count = self._index.counts.pop(channel)
            self._index.miss(f"{count} messages are lost: no record describes their channel")
        if not self._index.missing and self._counted > self._index.message_count:
            self._index.miss(f"its summary counts {self._counted} messages")

    def _chunk(self, offset: int, end: int) -> None:
        if end <= self._file.size:
            try:
                self._add(PlaceKind.CHUNK, offset, end)
            except BeyondLimit:
                raise
            except Damaged as damage:
                self._index.miss(f"bytes {offset} to {end} are lost: {damage}")
            return
        # A writer that only appends leaves the beginning of its chunk. robotctl overwrites its
        # trailer, so bytes of the old trailer may follow the beginning of the chunk.
        if not self.own:
            self._add(PlaceKind.TORN_CHUNK, offset, end)
        raise Damaged("the file ends in the middle of a chunk")

    def _loose(self, offset: int, end: int) -> None:
        if offset != self._loose_end or end - self._loose_start > _LOOSE_RUN_BYTES:
            self._end_loose_run()
            self._loose_start = offset
        self._loose_end = end

    def _end_loose_run(self) -> None:
        if self._loose_end > self._loose_start:
            self._add(PlaceKind.LOOSE, self._loose_start, self._loose_end)
        self._loose_start = self._loose_end = 0

    def _add(self, kind: PlaceKind, offset: int, end: int) -> None:
        """Add the place if it has messages, and count them.

        Raises:
            Damaged: The place cannot be read.
        """
        place = Place(kind, offset, end - offset, 0, 0, None)
        if kind is not PlaceKind.LOOSE:
            ref = read_chunk_ref(self._file, offset, end - offset)
            self.budget.spend(ref.uncompressed_size)
        data = place.read(self._file)
        counts: dict[int, int] = {}
        definitions: list[tuple[int, bytes]] = []
        times: list[int] = []
        records, most = 0, sys.maxsize
        if kind is not PlaceKind.LOOSE:  # the records of a loose run are counted already
            most = self._file.limits.records - self._records
        try:
            for opcode, start, stop in walk_records(data, most):
                records += 1
                if opcode == Opcode.MESSAGE:
                    channel, _, log_ns, _ = MESSAGE_FIELDS.unpack_from(data, start)
                    counts[channel] = counts.get(channel, 0) + 1
                    times.append(log_ns)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    definitions.append((opcode, data[start:stop]))
        except BeyondLimit:
            raise
        except Damaged:
            if kind is not PlaceKind.TORN_CHUNK:
                raise
        finally:
            if kind is not PlaceKind.LOOSE:
                self._records += records
        for opcode, content in definitions:
            self._define(opcode, content)
        if counts:
            self._take_in(place, counts, min(times), max(times))

    def _take_in(self, place: Place, counts: dict[int, int], start_ns: int, end_ns: int) -> None:
        index = self._index
        index.start_ns = start_ns if self._empty else min(index.start_ns, start_ns)
        index.end_ns = max(index.end_ns, end_ns)
        self._empty = False
        for channel, count in counts.items():
            index.counts[channel] = index.counts.get(channel, 0) + count
        index.places.append(
            replace(place, start_ns=start_ns, end_ns=end_ns, channels=frozenset(counts))
        )

    def _define(self, opcode: int, content: bytes) -> None:
        known = opcode, int.from_bytes(content[:2], "little")
        if self._definitions.get(known) == content:
            return  # some writers repeat it in each chunk
        self._definitions[known] = content
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, content)
            self._index.schemas[schema.id] = schema
        else:
            channel = parse(Channel, content)
            self._index.channels[channel.id] = channel


_GROWING_S = 2.0
"""How long reading a growing file is retried before it is scanned."""

_LOOK_AGAIN_S = 0.002


def index_of(
    file: InputFile,
    on_progress: Callable[[int], None] = lambda offset: None,
    *,
    places: bool = True,
) -> FileIndex:
    """Return the index of a file.

    `on_progress` gets the offset that a scan has reached. Without `places`, this takes less time,
    but messages cannot be read with the index.

    Raises:
        Damaged: Not even the header can be read.
    """
    index = _index_of(file, on_progress, places=places)
    index.message_compression = message_compression(index.metadata, file.path)
    if index.message_compression not in ("", ZSTD):
        index.places = []
        index.miss(
            f"its messages are compressed with {index.message_compression[:40]}, one by one: "
            "this is not supported"
        )
    return index


def _index_of(file: InputFile, on_progress: Callable[[int], None], *, places: bool) -> FileIndex:
    deadline = time.monotonic() + _GROWING_S
    while True:
        file.refresh()
        try:
            index = index_from_summary(file, places=places)
            if places:
                _complete(file, index)
            return index
        except Damaged:
            if not file.is_changing() or time.monotonic() > deadline:
                break
        time.sleep(_LOOK_AGAIN_S)  # a writer may be interrupted within a write
    return index_by_scanning(file, on_progress)


def _complete(file: InputFile, index: FileIndex) -> None:
    """Find records that the summary does not list; report those that it counts but are not found.

    In files of other writers, all gaps of the summary are read. A summary of robotctl lists all
    records, and what a killed commit left in a gap is no part of the file. So its gaps are only
    read if it counts more metadata records than it lists.
    """
    if not index.library.startswith(OWN_LIBRARY) or index.declared_metadata > len(index.metadata):
        read_gaps(file, index)
    for told, found, noun in (
        (index.declared_attachments, len(index.attachments), "attachments"),
        (index.declared_metadata, len(index.metadata), "metadata records"),
    ):
        if told > found and not index.missing:
            index.miss(f"its summary counts {told} {noun}, and {found} are there")
