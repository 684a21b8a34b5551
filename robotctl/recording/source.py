"""The places of files in which messages lie, and the messages in one of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from mcap.opcode import Opcode

from robotctl.recording.file_index import FileIndex, Place, PlaceKind
from robotctl.recording.mcap_input import MESSAGE_FIELDS, Damaged, InputFile, walk_records

Window = tuple[int, int]
"""The first and the last log time that are wanted [ns]."""

ALWAYS: Final[Window] = (0, (1 << 64) - 1)


_Fields = tuple[int, int, int, int]
"""Of a message: channel, sequence, log and publish time."""


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


class Source:
    """A place in a file and, once it is loaded, its messages that are still to come.

    Only those in the log times of `window` (ns, both included), and of the channels in `names`,
    which gives topic and type of each.
    """

    __slots__ = ("_data", "_names", "entries", "file", "loaded", "next", "place", "size", "window")

    def __init__(
        self, file: OpenFile, place: Place, names: dict[int, tuple[str, str]], window: Window
    ) -> None:
        self.file = file
        self.window = window
        self.place = place
        self.entries: list[tuple[int, int, int]] = []  # log time, start and end of the content
        self.next = 0
        self.loaded = False
        self.size = 0
        self._names = names
        self._data = b""

    def may_hold(self, topics: Collection[str]) -> bool:
        """Whether a message of one of the topics may be among the wanted ones."""
        channels = self.place.channels
        return channels is None or any(
            topic in topics for channel, (topic, _) in self._names.items() if channel in channels
        )

    def load(self) -> None:
        """Read the place. Raises Damaged; `entries` then holds what came before the damage."""
        self.loaded = True
        data = self._data = self.place.read(self.file.file)
        self.size = len(data)
        first_ns, last_ns = self.window
        try:
            for start, end, (_, _, log_ns, _) in self._wanted(data):
                if first_ns <= log_ns <= last_ns:
                    self.entries.append((log_ns, start, end))
        finally:
            self.entries.sort()

    def take(self) -> Message:
        """The next message."""
        _, start, end = self.entries[self.next]
        self.next += 1
        return self._message(self._data, start, end, MESSAGE_FIELDS.unpack_from(self._data, start))

    def as_written(self) -> Iterator[Message]:
        """All messages in the order of the file, without `load`. Raises Damaged behind the last."""
        data = self.place.read(self.file.file)
        for start, end, fields in self._wanted(data):
            yield self._message(data, start, end, fields)

    def _wanted(self, data: bytes) -> Iterator[tuple[int, int, _Fields]]:
        """Start, end and fields of the messages of wanted channels. Raises Damaged at last."""
        unknown = 0
        names, unpack = self._names, MESSAGE_FIELDS.unpack_from
        try:
            for opcode, start, end in walk_records(data):
                if opcode == Opcode.MESSAGE:
                    fields = unpack(data, start)
                    if fields[0] in names:
                        yield start, end, fields
                    elif fields[0] not in self.file.index.channels:
                        unknown += 1
        except Damaged:
            if self.place.kind is not PlaceKind.TORN_CHUNK:  # where the tear was told before
                raise
        if unknown:
            raise Damaged(f"{unknown} messages belong to no channel")

    def _message(self, data: bytes, start: int, end: int, fields: _Fields) -> Message:
        channel, sequence, log_ns, publish_ns = fields
        topic, type_name = self._names[channel]
        content = data[start + MESSAGE_FIELDS.size : end]
        return Message(topic, type_name, content, log_ns, publish_ns, sequence)

    def loss(self, damage: Damaged) -> str:
        """What to say where the place cannot be read."""
        begin = self.place.offset
        return (
            f"{self.file.path.name}: messages between bytes {begin} and "
            f"{begin + self.place.length} are lost: {damage}"
        )

    def unload(self) -> None:
        """Give the memory back."""
        self._data = b""
        self.entries = []


def sources(
    files: Iterable[OpenFile], topics: Collection[str] | None, window: Window
) -> Iterator[Source]:
    """The places that may hold messages of `topics` (None: all) in the window."""
    for file in files:
        names = _names(file.index, topics)
        for place in file.index.places:
            in_time = place.start_ns <= window[1] and place.end_ns >= window[0]
            if in_time and (place.channels is None or not place.channels.isdisjoint(names)):
                yield Source(file, place, names, window)


def _names(index: FileIndex, topics: Collection[str] | None) -> dict[int, tuple[str, str]]:
    return {
        channel.id: (channel.topic, index.schemas[channel.schema_id].name)
        if channel.schema_id in index.schemas
        else (channel.topic, "")
        for channel in index.channels.values()
        if topics is None or channel.topic in topics
    }
