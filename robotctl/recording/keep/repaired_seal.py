"""The seal of a file that is repaired or copied: nothing is forged, and a link says "repaired"."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress

from mcap.opcode import Opcode

from robotctl.recording.format.records import MAGIC, RECORD_HEAD_BYTES
from robotctl.recording.format.seal_records import (
    LINK_OPCODE,
    MAX_OPENING_BYTES,
    NO_DIGEST,
    OPENING_OPCODE,
    Link,
    LinkKind,
    Opening,
)
from robotctl.recording.format.trailer import WrittenFile
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import read_content, read_record_head
from robotctl.recording.read.mcap_input import InputFile


def seal_of_repair(written: WrittenFile) -> Iterator[bytes]:
    """Yield the records to add to a sealed file before a repair writes: its newest head, and an
    unsigned link that says "repaired". None for a file without a seal.
    """
    if not written.seal:
        return
    try:
        head = Link.read(written.seal[RECORD_HEAD_BYTES:])
    except ValueError:  # not written by robotctl
        return
    yield head.record()
    yield Link(
        LinkKind.REPAIRED, head.number, written.data_end, time.time_ns(), head.digest
    ).record()


def seal_of_copy(file: InputFile) -> Iterator[bytes]:
    """Yield the records to add to the copy of a sealed file: the opening of the original, and an
    unsigned link that says "repaired". It covers no byte, and names the newest digest that was
    read of the original. None for a file without a seal.
    """
    opening: Opening | None = None
    newest = Link(LinkKind.REPAIRED, number=1, covered=0, time_ns=0, digest=NO_DIGEST)
    for opcode, content in _seal_records(file):
        with suppress(ValueError):  # not written by robotctl
            if opcode == LINK_OPCODE:
                newest = Link.read(content)
            elif opening is None:
                opening = Opening.read(content)
    if opening is None:
        return
    yield opening.record()
    yield Link(LinkKind.REPAIRED, newest.number, 0, time.time_ns(), newest.digest).record()


def _seal_records(file: InputFile) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record of a seal, up to the first damage."""
    offset = len(MAGIC)
    with suppress(Damaged):
        for _ in range(file.limits.records):
            opcode, length = read_record_head(file, offset)
            if opcode == Opcode.FOOTER:
                return
            if opcode in (OPENING_OPCODE, LINK_OPCODE) and length <= MAX_OPENING_BYTES:
                yield opcode, read_content(file, offset, length)
            offset += RECORD_HEAD_BYTES + length
