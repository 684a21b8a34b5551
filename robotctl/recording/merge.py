"""Messages of one or more files in the order of their log time, a few chunks in memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from operator import itemgetter
from pathlib import Path
from typing import Final, NamedTuple

from mcap.opcode import Opcode

from robotctl.recording.file_index import FileIndex, Place, PlaceKind
from robotctl.recording.mcap_input import MESSAGE_FIELDS, Damaged, InputFile, walk_records

MAX_OPEN_BYTES: Final = 256 << 20
"""Unpacked chunks held at once because their times overlap; of our own two at most do."""

_AFTER_ALL = (1 << 64, 0)


class Message(NamedTuple):
    """One recorded message; times in nanoseconds since the epoch, `data` as it was received."""

    topic: str
    type_name: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(frozen=True, slots=True)
class OpenFile:
    """A file of a recording."""

    path: Path
    file: InputFile
    index: FileIndex


class _Source:
    """A place in a file and, once it is loaded, its messages that are still to come."""

    __slots__ = ("_data", "_names", "entries", "file", "loaded", "next", "place", "size")

    def __init__(self, file: OpenFile, place: Place, names: dict[int, tuple[str, str]]) -> None:
        self.file = file
        self.place = place
        self.entries: list[tuple[int, int, int]] = []  # log time, start and end of the content
        self.next = 0
        self.loaded = False
        self.size = 0
        self._names = names
        self._data = b""

    def load(self) -> None:
        """Read the place. Raises Damaged; `entries` then holds what came before the damage."""
        self.loaded = True
        data = self._data = self.place.read(self.file.file)
        self.size = len(data)
        unknown = 0
        try:
            for opcode, start, end in walk_records(data):
                if opcode == Opcode.MESSAGE:
                    channel, _, log_ns, _ = MESSAGE_FIELDS.unpack_from(data, start)
                    if channel in self._names:
                        self.entries.append((log_ns, start, end))
                    elif channel not in self.file.index.channels:
                        unknown += 1
        except Damaged:
            if self.place.kind is not PlaceKind.TORN_CHUNK:  # where the tear was told before
                raise
        finally:
            self.entries.sort()
        if unknown:
            raise Damaged(f"{unknown} messages belong to no channel")

    def take(self) -> Message:
        """The next message."""
        log_ns, start, end = self.entries[self.next]
        self.next += 1
        channel, sequence, _, publish_ns = MESSAGE_FIELDS.unpack_from(self._data, start)
        topic, type_name = self._names[channel]
        data = self._data[start + MESSAGE_FIELDS.size : end]
        return Message(topic, type_name, data, log_ns, publish_ns, sequence)

    def unload(self) -> None:
        """Give the memory back."""
        self._data = b""
        self.entries = []


def merge(
    files: Sequence[OpenFile],
    topics: Collection[str] | None,
    on_missing: Callable[[str], None],
) -> Iterator[Message]:
    """The messages of `topics` (None: all); what is found to be lost is told to `on_missing`."""
    sources = [source for file in files for source in _sources(file, topics)]
    heap = [(source.place.start_ns, rank) for rank, source in enumerate(sources)]
    heapify(heap)
    held = 0
    while heap:
        _, rank = heappop(heap)
        source = sources[rank]
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
) -> Iterator[Message]:
    """As `merge`, but in the order in which the messages stand in the files."""
    for file in files:
        for source in _sources(file, topics):
            _load(source, MAX_OPEN_BYTES, on_missing)
            source.entries.sort(key=itemgetter(1))
            while source.next < len(source.entries):
                yield source.take()
            source.unload()


def _sources(file: OpenFile, topics: Collection[str] | None) -> Iterator[_Source]:
    index = file.index
    names = {
        channel.id: (channel.topic, index.schemas[channel.schema_id].name)
        if channel.schema_id in index.schemas
        else (channel.topic, "")
        for channel in index.channels.values()
        if topics is None or channel.topic in topics
    }
    for place in index.places:
        if place.channels is None or not place.channels.isdisjoint(names):
            yield _Source(file, place, names)


def _load(source: _Source, room: int, on_missing: Callable[[str], None]) -> None:
    place = source.place
    try:
        source.load()
        if source.size > room and room < MAX_OPEN_BYTES:
            source.unload()
            source.size = 0
            raise Damaged("too many chunks overlap in time")
    except Damaged as damage:
        on_missing(
            f"{source.file.path.name}: messages between bytes {place.offset} and "
            f"{place.offset + place.length} are lost: {damage}"
        )
