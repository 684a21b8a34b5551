"""Finds what a kill during a commit left between the data and a valid trailer."""

from __future__ import annotations

from collections.abc import Iterator

from mcap.opcode import Opcode

from robotctl.recording.format.records import PlainMessage
from robotctl.recording.format.seal_records import LINK_OPCODE, OPENING_OPCODE
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import (
    FileIndex,
    Place,
    PlaceKind,
    read_header,
    read_record_head,
)
from robotctl.recording.read.mcap_input import (
    MESSAGE_FIELDS,
    RECORD_HEAD,
    InputFile,
    walk_records,
)

_DATA = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.METADATA,
    OPENING_OPCODE,
    LINK_OPCODE,
)
"""The records of robotctl's files before DataEnd."""


def find_unfinished_commit(file: InputFile, index: FileIndex, data_end: int) -> int | None:
    """Return the offset after the last record of the data that belongs to the file; None if all do.

    `index` is that of the file's own summary, `data_end` the end of the data according to it.

    Raises:
        Damaged: Not even the header can be read, or a chunk of the index follows that offset.
    """
    indexed = {place.offset for place in index.places}
    last_indexed = max(indexed, default=0)
    _, offset = read_header(file)
    while offset < data_end:
        opcode, length = read_record_head(file, offset)
        end = offset + RECORD_HEAD.size + length
        unindexed = not _is_listed(file, index, opcode, offset) or (
            opcode == Opcode.CHUNK and offset not in indexed
        )
        if opcode not in _DATA or unindexed or end > data_end:
            if offset < last_indexed:
                raise Damaged("a record of another writer precedes its last chunk")
            return offset
        offset = end
    return None


def _is_listed(file: InputFile, index: FileIndex, opcode: int, offset: int) -> bool:
    """Return whether the summary lists the record at `offset`, if it is of a kind to be listed.

    Raises:
        Damaged: The record cannot be read.
    """
    if opcode == Opcode.METADATA:
        return offset in index.metadata_offsets
    if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
        return True
    number = int.from_bytes(file.read(offset + RECORD_HEAD.size, 2), "little")
    return number in (index.schemas if opcode == Opcode.SCHEMA else index.channels)


def messages_of_chunk(file: InputFile, offset: int) -> list[PlainMessage]:
    """Return the messages of the chunk at `offset`; none if there is no complete chunk."""
    try:
        opcode, length = read_record_head(file, offset)
        if opcode != Opcode.CHUNK:
            return []
        place = Place(PlaceKind.CHUNK, offset, RECORD_HEAD.size + length, 0, 0, None)
        return list(_messages(place.read(file)))
    except Damaged:
        return []


def _messages(data: bytes) -> Iterator[PlainMessage]:
    for opcode, start, end in walk_records(data):
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = MESSAGE_FIELDS.unpack_from(data, start)
            yield channel, data[start + MESSAGE_FIELDS.size : end], log_ns, publish_ns, sequence
