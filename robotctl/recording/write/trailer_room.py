"""Room between the data of a growing file and its trailer.

A trailer directly behind the data moves with each commit, and all of it is written to the disk
again: after ten minutes, 50 times as much as what was recorded. So a growing file has a record in
between that readers skip. Of the trailer, a commit changes only the last few hundred bytes.

The file is valid between any two writes of a commit:

(1) within the room: the new records without the head of the first, and the head of the room left;
(2) the head of the first record: from now on, sequential readers see them all;
(3) the end of the trailer.

Where the room is too small, the trailer first moves away:

(1) at the future end of the file: a footer that points back to the trailer;
(2) before it: a copy of the trailer; (3) the footer of that copy: from now on, readers of the index
do not need the old trailer; (4) the head of the room, which reaches to the copy.

What the summary lists elsewhere than at its end (a topic, an event, the end of the recording) takes
the room out again: within the room, the trailer is written behind the new records, and the file is
cut behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from robotctl.recording.disk.storage import Buffer, Storage
from robotctl.recording.format.records import RECORD_HEAD_BYTES, room_head
from robotctl.recording.format.trailer import FOOTER_BYTES, Summary, TrailerState

LEAST_BYTES: Final = 64 << 10
"""The least room that is made; at least that of the trailer is made. So each byte of a trailer is
written about once more for each byte recorded, however long the file."""

PAGE_BYTES: Final = 4096

COMMITS: Final = 3
"""The number of further commits of the same size that new room is made for."""


class Room(NamedTuple):
    """The room of a file: its data end at `start`, and the trailer `good` has `trailer_bytes`."""

    start: int
    good: TrailerState
    trailer_bytes: int

    def for_bytes(self, size: int, storage: Storage, summary: Summary) -> tuple[TrailerState, int]:
        """Move the trailer away unless `size` bytes fit before it.

        Returns the trailer's state, and the bytes that were written for it.

        Raises:
            OSError: The file must be cut back.
        """
        good = self.good
        if size + RECORD_HEAD_BYTES <= good.data_end - self.start:
            return good, 0
        more = max(LEAST_BYTES, self.trailer_bytes, COMMITS * size)
        moved = good.moved_to(good.data_end + size + more)
        trailer = summary.trailer(moved)
        footer_offset = moved.data_end + trailer.size - FOOTER_BYTES
        storage.write_at([good.distant_footer()], footer_offset)
        write_in_pages(trailer.before_footer, moved.data_end, storage)
        storage.write_at([trailer.footer], footer_offset)
        storage.write_at([room_head(self.start, moved.data_end)], self.start)
        return moved, trailer.size + FOOTER_BYTES


def write_hidden(parts: Sequence[Buffer], start: int, storage: Storage) -> None:
    """Write records at `start` into the room; the head of the first, which is last, shows them.

    Raises:
        OSError: The file must be cut back.
    """
    first, *others = [memoryview(part) for part in parts if len(part)]
    storage.write_at([first[RECORD_HEAD_BYTES:], *others], start + RECORD_HEAD_BYTES)
    storage.write_at([first[:RECORD_HEAD_BYTES]], start)


def write_in_pages(parts: Sequence[Buffer], offset: int, storage: Storage) -> None:
    """Write `parts` at `offset`, a page in each write.

    Linux keeps what is written at once in one folio of up to 2 MB, and counts and writes all of it
    again when a byte of it changes.

    Raises:
        OSError: The disk is full or fails.
    """
    whole = memoryview(b"".join(parts))
    for start in range(0, len(whole), PAGE_BYTES):
        storage.write_at([whole[start : start + PAGE_BYTES]], offset + start)
