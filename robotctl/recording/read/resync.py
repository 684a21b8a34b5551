"""Finds the next valid chunk in a file whose chain of records is broken."""

from __future__ import annotations

import re
import struct

from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.decompression import DECOMPRESSORS
from robotctl.recording.read.mcap_input import RECORD_HEAD, InputFile, walk_records
from robotctl.recording.read.stored_chunk import UnpackBudget, read_chunk, read_chunk_ref

_WINDOW_BYTES = 4 << 20
_COMPRESSIONS = [struct.pack("<I", len(name)) + name.encode() for name in DECOMPRESSORS]
_HEAD = re.compile(
    rb"\x06(?=.{8}.{28}(?:%b))" % b"|".join(map(re.escape, _COMPRESSIONS)), re.DOTALL
)
"""The opcode of a chunk, followed by lengths, times, sizes and a known compression."""

_NAME_OFFSET = RECORD_HEAD.size + 28
_HEAD_BYTES = _NAME_OFFSET + max(map(len, _COMPRESSIONS)) + 8
"""Maximum, from the opcode to the data."""


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
    """Return whether the length of the record fits the length of the data in it."""
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
