"""Messages of one or more files in the order of their log time, a few chunks in memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from heapq import heapify, heappop, heappush
from typing import Final

from robotctl.recording.mcap_input import Damaged
from robotctl.recording.source import ALWAYS, Message, OpenFile, Source, Window, sources

MAX_OPEN_BYTES: Final = 256 << 20
"""Unpacked chunks held at once because their times overlap; of our own two at most do."""

_AFTER_ALL = (1 << 64, 0)


def merge(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
    window: Window = ALWAYS,
) -> Iterator[Message]:
    """The messages of `topics` (None: all) in the window; places outside of it are not read.

    What is found to be lost is told to `on_missing`.
    """
    found = list(sources(files, topics, window))
    heap = [(source.place.start_ns, rank) for rank, source in enumerate(found)]
    heapify(heap)
    held = 0
    while heap:
        _, rank = heappop(heap)
        source = found[rank]
        if not source.loaded:
            _load(source, MAX_OPEN_BYTES - held, on_missing)
            held += source.size
        entries = source.entries
        ahead = heap[0] if heap else _AFTER_ALL
        while source.next < len(entries) and (entries[source.next][0], rank) < ahead:
            yield source.take()
        if source.next < len(entries):
            heappush(heap, (entries[source.next][0], rank))
        else:
            held -= source.size
            source.unload()


def in_order_written(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[Message]:
    """As `merge`, but as the messages stand in the files; tells bytes done and in total."""
    done, total = 0, sum(file.file.size for file in files)
    for file in files:
        for source in sources([file], topics, ALWAYS):
            try:
                yield from source.as_written()
            except Damaged as damage:
                on_missing(source.loss(damage))
            on_progress(done + source.place.offset + source.place.length, total)
        done += file.file.size
        on_progress(done, total)


def _load(source: Source, room: int, on_missing: Callable[[str], None]) -> None:
    try:
        source.load()
        if source.size > room and room < MAX_OPEN_BYTES:
            source.unload()
            source.size = 0
            raise Damaged("too many chunks overlap in time")
    except Damaged as damage:
        on_missing(source.loss(damage))
