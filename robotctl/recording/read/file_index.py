"""The index of one MCAP file: topics, message counts, metadata, and places of messages."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema

from robotctl.recording.format.names import (
    FOXGLOVE_RECORD,
    INFO_RECORD,
    OWN_LIBRARY,
    SOFTWARE_RECORD,
)
from robotctl.recording.format.topics import Topic
from robotctl.recording.read.chunks import read_chunk, read_chunk_head, stored_size_of
from robotctl.recording.read.read_limits import BeyondLimit, Damaged, Tally
from robotctl.recording.read.records import RECORD_HEAD, InputFile, head_blocks, parse

MAX_SENTENCES = 20
"""Maximum number of sentences about missing parts."""


class PlaceKind(Enum):
    """Whether the messages of a place are in a chunk or outside any."""

    CHUNK = "chunk"
    TORN_CHUNK = "torn chunk"
    """A chunk cut off by the end of the file."""

    LOOSE = "loose"
    """A run of records outside any chunk."""


@dataclass(frozen=True, slots=True)
class Place:
    """A part of a file with messages, `length` bytes at `offset`. Log times are in ns.

    `channels` has the ids of the channels with messages there, None if unknown. `unpacked_bytes`
    and `compression` are what the summary states, None and "" if the file has no summary.
    """

    kind: PlaceKind
    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] | None
    unpacked_bytes: int | None = None
    compression: str = ""

    def size_in_memory(self, file: InputFile) -> int:
        """Return how many bytes `read` will return, as the summary or the chunk's head states.

        Raises:
            Damaged: The head of the chunk cannot be read.
        """
        if self.kind is PlaceKind.LOOSE:
            return self.length
        if self.unpacked_bytes is not None:
            return self.unpacked_bytes
        return read_chunk_head(file, self.offset, self.length).uncompressed_size

    def read(self, file: InputFile) -> bytes:
        """Return the records at this place, decompressed.

        Raises:
            Damaged: The records cannot be read, or contradict the summary.
        """
        if self.kind is PlaceKind.LOOSE:
            return file.read(self.offset, self.length)
        head = read_chunk_head(file, self.offset, self.length)
        if self.unpacked_bytes is not None:
            told = self.unpacked_bytes, self.compression, self.start_ns, self.end_ns
            if (head.uncompressed_size, head.compression, head.start_ns, head.end_ns) != told:
                raise Damaged("a chunk is not the one that the summary describes")
        return read_chunk(file, head, torn=self.kind is PlaceKind.TORN_CHUNK)


class Contents:
    """The messages of a `Place`, which is a chunk or a run of records outside chunks."""

    def __init__(self) -> None:
        self.records = 0
        """The number of walked records."""

        self.entries: dict[int, array[int]] = {}
        """Log time [ns] and position of each message, alternately, by channel."""

    def walk(
        self,
        data: bytes,
        most: int,
        define: Callable[[int, bytes], object],
        begin: Callable[[int], None] = lambda channel: None,
    ) -> None:
        """Add the messages in `data`, the decompressed records of a place, to `entries`.

        `define` gets opcode and content of each schema and channel record, `begin` the id of each
        channel at its first message.

        Raises:
            Damaged: A record is cut off or malformed.
            BeyondLimit: There are more than `most` records.
        """
        message, every = Opcode.MESSAGE.value, self.entries
        for block in head_blocks(data, most):
            self.records += len(block)
            for position, (opcode, length, channel, _, log_ns, _) in block:
                if opcode == message:
                    entries = every.get(channel)
                    if entries is None:
                        begin(channel)
                        entries = every[channel] = array("Q")
                    entries.extend((log_ns, position))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    start = position + RECORD_HEAD.size
                    define(opcode, data[start : start + length])

    @property
    def counts(self) -> dict[int, int]:
        """The number of messages by channel."""
        return {channel: len(entries) // 2 for channel, entries in self.entries.items()}

    def window(self) -> tuple[int, int]:
        """Return the lowest and the highest log time [ns]. There must be a message."""
        times = [entries[::2] for entries in self.entries.values()]
        return min(map(min, times)), max(map(max, times))


OF_EACH_FILE: Final = (INFO_RECORD, SOFTWARE_RECORD, FOXGLOVE_RECORD)
"""Metadata about robot and recording software, repeated in each file of a recording."""


def topic_of(channel: Channel, type_name: str) -> Topic:
    """Return the `metadata.yaml` entry of `channel`, whose messages have the type `type_name`."""
    return Topic(
        name=channel.topic,
        type_name=type_name,
        type_hash=channel.metadata.get("topic_type_hash", ""),
        offered_qos=channel.metadata.get("offered_qos_profiles", ""),
        encoding=channel.message_encoding,
    )


def note_missing(missing: list[str], sentence: str) -> None:
    """Append `sentence` to `missing`, or "and more" once MAX_SENTENCES are there."""
    if len(missing) < MAX_SENTENCES:
        missing.append(sentence)
    elif len(missing) == MAX_SENTENCES:
        missing.append("and more")


@dataclass(slots=True)
class FileIndex:
    """The index of one file. `missing` has a sentence per unreadable part."""

    header: Header
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    places: list[Place] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int = 0
    end_ns: int = 0
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[int] = field(default_factory=list)
    """Offsets of the attachment records."""

    missing: list[str] = field(default_factory=list)
    scanned: bool = False
    """Whether the file had no valid summary."""

    message_compression: str = ""
    """The compression of each message, "" if messages are not compressed separately."""

    gaps: list[tuple[int, int]] = field(default_factory=list)
    """Start and end [bytes] of the parts of the data that the summary does not describe."""

    declared_metadata: int = 0
    declared_attachments: int = 0
    """Number of attachment records by the summary."""

    metadata_offsets: set[int] = field(default_factory=set)
    """Offsets of the records in `metadata`."""

    records: Tally = field(default_factory=Tally)
    """Number of walked records by the offset of their place."""

    unpacked: Tally = field(default_factory=Tally)
    """The cost of decompressing single messages, by the offset of their place."""

    messages_read: dict[int, int] = field(default_factory=dict)
    """Message counts of the completely read places, by the offset of each place."""

    limit_reached: bool = False
    """Whether a missing part can be read with higher limits."""

    def miss(self, sentence: str) -> None:
        """Add a sentence about an unreadable part."""
        note_missing(self.missing, sentence)

    def miss_beyond(self, what: str, limit: BeyondLimit) -> None:
        """Add a sentence about an unread part that exceeds the limits."""
        self.limit_reached = True
        self.miss(f"{what}: {limit}")

    def count(self, counts: Mapping[int, int], start_ns: int, end_ns: int) -> None:
        """Add message counts by channel id, with the lowest and highest log time [ns]."""
        self.start_ns = min(self.start_ns, start_ns) if self.counts else start_ns
        self.end_ns = max(self.end_ns, end_ns)
        for channel, count in counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count

    def define(self, opcode: int, content: bytes) -> None:
        """Add the schema or channel whose record has this content.

        Raises:
            Damaged: The record is malformed.
        """
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, content)
            self.schemas[schema.id] = schema
        else:
            channel = parse(Channel, content)
            self.channels[channel.id] = channel

    def unaccounted(self) -> str:
        """Return a sentence if all places were read but the message count is wrong, else ""."""
        read = self.messages_read
        if self.scanned or self.limit_reached or not self.places:
            return ""  # another sentence says why not all was read
        if any(place.offset not in read for place in self.places):
            return ""
        found = sum(read[place.offset] for place in self.places)
        if found == self.message_count:
            return ""
        return f"its summary counts {self.message_count} messages, and {found} are there"

    @property
    def own(self) -> bool:
        """Whether robotctl wrote the file."""
        return self.header.library.startswith(OWN_LIBRARY)

    def has_metadata(self, *names: str) -> bool:
        """Return whether there is a metadata record with one of these names."""
        return any(record.name in names for record in self.metadata)

    @property
    def message_count(self) -> int:
        """The number of readable messages of all channels."""
        return sum(self.counts.values())


_BEGIN = struct.Struct("<QQQQI")
"""Start and end time [ns], offset and length of the chunk record, size of the following map."""

_TIMES = struct.Struct("<QQ")
_CHANNEL = struct.Struct("<H8x")
_MIDDLE = struct.Struct("<QI")
"""Bytes of the message indexes, length of the compression's name."""

_SIZES = struct.Struct("<QQ")
"""Compressed and uncompressed size."""


def read_chunk_times(data: bytes, position: int, end: int) -> tuple[int, int]:
    """Return the lowest and the highest log time [ns] in a chunk index record.

    Raises:
        Damaged: The record is too short.
    """
    if position + _TIMES.size > end:
        raise Damaged("a chunkindex record is malformed")
    start_ns, end_ns = _TIMES.unpack_from(data, position)
    return start_ns, end_ns


def read_chunk_index(data: bytes, position: int, end: int) -> tuple[Place, int]:
    """Return the chunk of an index record, `data[position:end]`, and where its message indexes end.

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
        PlaceKind.CHUNK, offset, length, start_ns, end_ns, channels or None, unpacked, compression
    )
    return place, offset + length + indexes_length
