"""The index of one MCAP file: what it holds and where, as far as known."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from robotctl.recording.format.records import MAGIC
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.mcap_input import (
    MAX_RECORD_BYTES,
    RECORD_HEAD,
    InputFile,
    parse,
)
from robotctl.recording.read.read_limits import ReadTally
from robotctl.recording.read.stored_chunk import (
    read_chunk,
    read_chunk_ref,
    read_torn_chunk,
    stored_size_of,
)

MAX_SENTENCES = 20
"""Maximum number of sentences about missing parts."""


_CRC = struct.Struct("<I")
_ATTACHMENT_FIXED_BYTES = 8 + 8 + 4 + 4 + 8
"""Log time, create time, lengths of name and media type, size of the data."""


class PlaceKind(Enum):
    """How messages are stored."""

    CHUNK = "chunk"
    TORN_CHUNK = "torn chunk"
    """A chunk that the end of the file cuts off."""

    LOOSE = "loose"
    """A run of records outside any chunk."""


@dataclass(frozen=True, slots=True)
class Place:
    """A part of the file that holds messages: `length` bytes at `offset`, log times in ns.

    `channels` are the ids of the channels with messages there, None if unknown. `unpacked_bytes`
    and `compression` are what the summary says about a chunk: None and "" if it says nothing.
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
        """Return how many bytes `read` will return, as the file claims.

        Raises:
            Damaged: The head of the chunk cannot be read.
        """
        if self.kind is PlaceKind.LOOSE:
            return self.length
        if self.unpacked_bytes is not None:
            return self.unpacked_bytes
        return read_chunk_ref(file, self.offset, self.length).uncompressed_size

    def read(self, file: InputFile) -> bytes:
        """Return the records at this place, decompressed.

        Raises:
            Damaged: They cannot be read, or contradict the summary.
        """
        if self.kind is PlaceKind.LOOSE:
            return file.read(self.offset, self.length)
        ref = read_chunk_ref(file, self.offset, self.length)
        if self.unpacked_bytes is not None:
            told = self.unpacked_bytes, self.compression, self.start_ns, self.end_ns
            if (ref.uncompressed_size, ref.compression, ref.start_ns, ref.end_ns) != told:
                raise Damaged("a chunk is not the one that the summary describes")
        return (read_chunk if self.kind is PlaceKind.CHUNK else read_torn_chunk)(file, ref)


def note_missing(missing: list[str], sentence: str) -> None:
    """Append `sentence` to `missing`; after MAX_SENTENCES of them, append "and more" instead."""
    if len(missing) < MAX_SENTENCES:
        missing.append(sentence)
    elif len(missing) == MAX_SENTENCES:
        missing.append("and more")


@dataclass(slots=True)
class FileIndex:
    """The content of one file; `missing` says in sentences what cannot be read."""

    profile: str
    library: str
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
    """The compression of each message; "" if messages are not compressed separately."""

    gaps: list[tuple[int, int]] = field(default_factory=list)
    """Parts of the data that the summary does not describe: start and end [bytes]."""

    declared_metadata: int = 0
    declared_attachments: int = 0
    """The numbers of metadata and attachment records that the summary counts."""

    metadata_offsets: set[int] = field(default_factory=set)
    """Offsets of the records in `metadata`."""

    tally: ReadTally = field(default_factory=ReadTally)

    limit_reached: bool = False
    """Whether a part was left out that could be read with higher limits."""

    def miss(self, sentence: str) -> None:
        """Add a sentence about something that cannot be read."""
        note_missing(self.missing, sentence)

    def miss_beyond(self, what: str, limit: BeyondLimit) -> None:
        """Add a sentence about something that was not read because it exceeds the limits."""
        self.limit_reached = True
        self.miss(f"{what}: {limit}")

    def unaccounted(self) -> str:
        """Return a sentence if all was read and the summary's message count differs, else ""."""
        found = self.tally.messages_in(place.offset for place in self.places)
        if self.scanned or self.limit_reached or not self.places:
            return ""  # another sentence says why not all was read
        if found is None or found == self.message_count:
            return ""
        return f"its summary counts {self.message_count} messages, and {found} are there"

    def has_metadata(self, *names: str) -> bool:
        """Return whether there is a metadata record with one of these names."""
        return any(record.name in names for record in self.metadata)

    @property
    def message_count(self) -> int:
        """The number of messages that can be read, of all channels."""
        return sum(self.counts.values())


class ZeroedHeader(Damaged):
    """The file begins with zeros, which a power cut can cause."""

    def __init__(self) -> None:
        super().__init__("it is not an MCAP file: it begins with zeros")


LOST_HEADER = Header(profile="", library=""), len(MAGIC)
"""What replaces a header of zeros: an empty header, and the offset where the data begins."""


def read_record_head(file: InputFile, offset: int) -> tuple[int, int]:
    """Return the opcode and the content length of the record at `offset`.

    Raises:
        Damaged: The file ends there.
    """
    opcode, length = RECORD_HEAD.unpack(file.read(offset, RECORD_HEAD.size))
    return opcode, length


def read_content(file: InputFile, offset: int, length: int) -> bytes:
    """Return the content of the record at `offset`.

    Raises:
        Damaged: The file ends there, or the length is not plausible.
    """
    if length > MAX_RECORD_BYTES:
        raise Damaged(f"a record at byte {offset} claims {length} bytes")
    return file.read(offset + RECORD_HEAD.size, length)


def read_attachment(file: InputFile, offset: int) -> Attachment:
    """Return the attachment whose record is at `offset`.

    Fields after the checksum, which a later version of the format may add, are ignored.

    Raises:
        Damaged: There is no attachment, its checksum is wrong, or it is too large.
    """
    opcode, length = read_record_head(file, offset)
    if opcode != Opcode.ATTACHMENT:
        raise Damaged("there is no attachment")
    if length > file.limits.attachment_bytes:
        raise BeyondLimit(f"it has {length} bytes, more than {file.limits.attachment_bytes}")
    content = file.read(offset + RECORD_HEAD.size, length)
    attachment: Attachment = parse(Attachment, content)
    covered = _attachment_bytes(attachment)
    (crc,) = _CRC.unpack_from(content, covered)
    if crc and crc != crc32(memoryview(content)[:covered]):
        raise Damaged("its checksum is wrong")
    return attachment


def _attachment_bytes(attachment: Attachment) -> int:
    """Return how many bytes of its record the checksum of an attachment covers."""
    texts = len(attachment.name.encode()) + len(attachment.media_type.encode())
    return _ATTACHMENT_FIXED_BYTES + texts + len(attachment.data)


def read_header(file: InputFile) -> tuple[Header, int]:
    """Return the header, and the offset after it.

    Raises:
        ZeroedHeader: The file begins with zeros; it may be an MCAP file.
        Damaged: It is not an MCAP file.
    """
    if file.size == 0:
        raise Damaged("it is empty")
    if not any(file.read(0, min(file.size, len(MAGIC) + RECORD_HEAD.size))):
        raise ZeroedHeader
    if file.size < len(MAGIC) or file.read(0, len(MAGIC)) != MAGIC:
        raise Damaged("it is not an MCAP file")
    opcode, length = read_record_head(file, len(MAGIC))
    if opcode != Opcode.HEADER:
        raise Damaged("it does not begin with a header")
    header = parse(Header, read_content(file, len(MAGIC), length))
    return header, len(MAGIC) + RECORD_HEAD.size + length


_BEGIN = struct.Struct("<QQQQI")
"""Start and end time [ns], offset and length of the chunk record, and the size in bytes of the
following map, which gives the offset of the message index of each channel in the chunk."""

_CHANNEL = struct.Struct("<H8x")
_MIDDLE = struct.Struct("<QI")
"""Bytes of the message indexes, length of the compression's name."""

_SIZES = struct.Struct("<QQ")
"""Compressed and uncompressed size."""


class ChunkEntry(NamedTuple):
    """A chunk, and the offset after the message indexes that follow it."""

    place: Place
    end: int


def read_chunk_index(data: bytes, position: int, end: int) -> ChunkEntry:
    """Return the chunk that a chunk index describes, whose content is `data[position:end]`.

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
        PlaceKind.CHUNK,
        offset,
        length,
        start_ns,
        end_ns,
        channels or None,
        unpacked,
        compression,
    )
    return ChunkEntry(place, offset + length + indexes_length)
