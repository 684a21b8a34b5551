"""The content of a file's data section, found by reading every byte of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)

from robotctl.recording.format.names import OWN_LIBRARY
from robotctl.recording.read.mcap_input import parse

MAX_FLAWS: Final = 20
"""Maximum number of flaws of a file that are kept; further flaws are only counted."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """A part of a file that is not as it was written: the bytes from `start` to `end`.

    `end` is the offset after the last byte. `text` says what is wrong, without place and file name.
    """

    start: int
    end: int
    text: str

    def sentence(self) -> str:
        """Return place and text as one sentence."""
        return f"bytes {self.start} to {self.end}: {self.text}"


@dataclass(slots=True)
class Flaws:
    """The first flaws of one file in file order, and the number of all flaws."""

    kept: list[Flaw] = field(default_factory=list)
    count: int = 0

    def add(self, start: int, end: int, text: str) -> None:
        """Add a flaw."""
        self.count += 1
        if len(self.kept) < MAX_FLAWS:
            self.kept.append(Flaw(start, end, text))


@dataclass(slots=True)
class WholeData:
    """The content of a data section; offsets in bytes, times in nanoseconds.

    `end` is the offset of the DataEnd record, or where the reading had to stop. `crc` is the
    checksum of all bytes before `end`, `told_crc` the checksum in the DataEnd record (0 means that
    the writer computed none), or None without such a record.
    """

    header: Header
    end: int = 0
    crc: int = 0
    told_crc: int | None = None
    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    """The contents of the schema and channel records, by id."""

    type_names: dict[int, str] = field(default_factory=dict)
    """The names of the schemas, by id."""

    topics: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[int, Metadata] = field(default_factory=dict)
    metadata_indexes: dict[int, MetadataIndex] = field(default_factory=dict)
    attachment_indexes: dict[int, AttachmentIndex] = field(default_factory=dict)
    chunk_indexes: dict[int, ChunkIndex] = field(default_factory=dict)
    """The chunk index that describes each chunk, by the chunk's offset."""

    bad_chunks: set[int] = field(default_factory=set)
    """Offsets of the chunks that cannot be read."""

    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel."""

    start_ns: int = 0
    end_ns: int = 0
    private: list[tuple[int, int, int]] = field(default_factory=list)
    """Opcode, offset and length of the content of each private record."""

    private_in_summary: list[tuple[int, bytes]] = field(default_factory=list)
    """Opcode and content of each private record of the summary."""

    unread: str = ""
    """A sentence about what was not read, "" if everything was read."""

    before_last_chunk: tuple[dict[int, int], int, int] = field(default_factory=lambda: ({}, 0, 0))
    """The values of `counts`, `start_ns` and `end_ns` without the last chunk."""

    unfinished: int | None = None
    """The offset of a commit that was not finished; it reaches to the end of the data."""

    @property
    def own(self) -> bool:
        """Whether robotctl wrote the file."""
        return self.header.library.startswith(OWN_LIBRARY)

    @property
    def message_count(self) -> int:
        """The number of messages of all channels."""
        return sum(self.counts.values())

    def has_metadata(self, *names: str) -> bool:
        """Return whether there is a metadata record with one of these names."""
        return any(record.name in names for record in self.metadata.values())

    def add_messages(self, channel: int, count: int, start_ns: int, end_ns: int) -> None:
        """Count messages of a channel, with their first and last log time."""
        if self.counts:
            self.start_ns = min(self.start_ns, start_ns)
            self.end_ns = max(self.end_ns, end_ns)
        else:
            self.start_ns, self.end_ns = start_ns, end_ns
        self.counts[channel] = self.counts.get(channel, 0) + count

    def begin_chunk(self) -> None:
        """Store the present counts as `before_last_chunk`."""
        self.before_last_chunk = dict(self.counts), self.start_ns, self.end_ns

    def define(
        self, opcode: int, content: bytes, place: tuple[int, int], flaws: Flaws
    ) -> Schema | Channel:
        """Add a schema or a channel that stands at `place`, and return it.

        Raises:
            Damaged: The record is malformed.
        """
        record: Schema | Channel
        if opcode == Opcode.SCHEMA:
            record, known = self._schema(parse(Schema, content)), self.schemas
        else:
            record, known = self._channel(parse(Channel, content), place, flaws), self.channels
        if known.setdefault(record.id, content) != content:
            flaws.add(*place, f"it describes {record.id} in another way than an earlier record")
        return record

    def _schema(self, schema: Schema) -> Schema:
        self.type_names.setdefault(schema.id, schema.name)
        return schema

    def _channel(self, channel: Channel, place: tuple[int, int], flaws: Flaws) -> Channel:
        if channel.schema_id and channel.schema_id not in self.schemas:
            flaws.add(*place, f"channel {channel.id} has a schema that is not there")
        self.topics.setdefault(channel.id, channel)
        return channel
