"""Messages of one or more files in the order of their log time, with few chunks in memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from heapq import heapify, heappop, heappush

from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.messages import (
    ALWAYS,
    Message,
    OpenFile,
    PlaceReader,
    Window,
    place_readers,
)

_AFTER_ALL = (1 << 64, 0)


def merge(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
    window: Window = ALWAYS,
) -> Iterator[Message]:
    """Yield the messages of `topics` (None: all) in the window; places outside of it are not read.

    `on_missing` gets a sentence about each lost part.
    """
    found = list(place_readers(files, topics, window))
    heap = [(source.place.start_ns, rank) for rank, source in enumerate(found)]
    heapify(heap)
    held = 0
    most = max((file.file.limits.open_bytes for file in files), default=0)
    while heap:
        _, rank = heappop(heap)
        source = found[rank]
        if not source.loaded:
            _load(source, most - held if held else None, on_missing)
            held += source.size
        entries = source.entries
        ahead = heap[0] if heap else _AFTER_ALL
        while source.next < len(entries) and (entries[source.next][0], rank) < ahead:
            try:
                message = source.take()
            except Damaged as damage:
                on_missing(source.loss(damage))
                continue
            yield message
        if source.next < len(entries):
            heappush(heap, (entries[source.next][0], rank))
        else:
            held -= source.size
            source.unload()
    _tell_unaccounted(files, on_missing)


def in_order_written(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[list[Message]]:
    """Yield messages as `merge` does, but in file order, many at once; `on_progress` gets bytes
    done and in total.
    """
    done, total = 0, sum(file.file.size for file in files)
    for file in files:
        for source in place_readers([file], topics, ALWAYS):
            try:
                yield from source.as_written()
            except Damaged as damage:
                on_missing(source.loss(damage))
            on_progress(done + source.place.offset + source.place.length, total)
        done += file.file.size
        on_progress(done, total)
    _tell_unaccounted(files, on_missing)


def _tell_unaccounted(files: Sequence[OpenFile], on_missing: Callable[[str], None]) -> None:
    """Compare what was read with the counts in the summaries."""
    for file in files:
        sentence = file.index.unaccounted()
        if sentence:
            on_missing(f"{file.path.name}: {sentence}")


def _load(source: PlaceReader, room: int | None, on_missing: Callable[[str], None]) -> None:
    """Load a place if it fits into `room` [bytes]; None means no limit."""
    try:
        if room is not None and source.place.size_in_memory(source.file.file) > room:
            source.loaded = True
            raise BeyondLimit("too many chunks overlap in time")
        source.load()
    except Damaged as damage:
        on_missing(source.loss(damage))
