"""The seal of a file that is repaired: what was signed stays signed, and nothing is forged."""

from __future__ import annotations

import time
from collections.abc import Iterator

from robotctl.recording.format.records import RECORD_HEAD_BYTES
from robotctl.recording.format.seal_records import Link, LinkKind
from robotctl.recording.format.trailer import WrittenFile


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
