"""What one MCAP file holds and where, as far as it is known."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import Enum

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from robotctl.recording.mcap_format import MAGIC
from robotctl.recording.mcap_input import (
    MAX_RECORD_BYTES,
    RECORD_HEAD,
    Damaged,
    InputFile,
    parse,
    read_chunk,
    read_chunk_ref,
    read_torn_chunk,
)

MAX_ATTACHMENT_BYTES = 256 << 20
"""A larger attachment is not taken into memory."""

MAX_SENTENCES = 20
"""What is missing is said in so many sentences at most."""


_CRC = struct.Struct("<I")


class PlaceKind(Enum):
    """How messages lie in a file."""

    CHUNK = "chunk"
    TORN_CHUNK = "torn chunk"
    """The end of the file cuts it off."""

    LOOSE = "loose"
    """A run of records outside any chunk."""


@dataclass(frozen=True, slots=True)
class Place:
    """A part of the file that holds messages: `length` bytes at `offset`, log times in ns.

    `channels` are those that have messages there; None if that is not known.
    """

    kind: PlaceKind
    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] | None

    def read(self, file: InputFile) -> bytes:
        """The records at this place, unpacked. Raises Damaged."""
        if self.kind is PlaceKind.LOOSE:
            return file.read(self.offset, self.length)
        ref = read_chunk_ref(file, self.offset, self.length)
        return (read_chunk if self.kind is PlaceKind.CHUNK else read_torn_chunk)(file, ref)


def note_missing(missing: list[str], sentence: str) -> None:
    """Append `sentence`, but let the list not grow beyond what anybody reads."""
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
    """Offsets of their records."""

    missing: list[str] = field(default_factory=list)
    scanned: bool = False
    """There was no valid summary."""

    def miss(self, sentence: str) -> None:
        """Say that something cannot be read."""
        note_missing(self.missing, sentence)

    def has_metadata(self, *names: str) -> bool:
        """Whether there is a metadata record of one of these names."""
        return any(record.name in names for record in self.metadata)

    @property
    def message_count(self) -> int:
        """Messages that can be read, over all channels."""
        return sum(self.counts.values())


def read_record_head(file: InputFile, offset: int) -> tuple[int, int]:
    """Opcode and length of the record at `offset`. Raises Damaged."""
    opcode, length = RECORD_HEAD.unpack(file.read(offset, RECORD_HEAD.size))
    return opcode, length


def read_content(file: InputFile, offset: int, length: int) -> bytes:
    """The content of the record at `offset`. Raises Damaged, also where it is absurdly long."""
    if length > MAX_RECORD_BYTES:
        raise Damaged(f"a record at byte {offset} claims {length} bytes")
    return file.read(offset + RECORD_HEAD.size, length)


def read_attachment(file: InputFile, offset: int) -> Attachment:
    """The attachment whose record is at `offset`. Raises Damaged."""
    _, length = read_record_head(file, offset)
    if length > MAX_ATTACHMENT_BYTES:
        raise Damaged(f"it has {length} bytes")
    content = file.read(offset + RECORD_HEAD.size, length)
    attachment: Attachment = parse(Attachment, content)
    (crc,) = _CRC.unpack(content[-_CRC.size :])
    if crc and crc != crc32(memoryview(content)[: -_CRC.size]):
        raise Damaged("its checksum is wrong")
    return attachment


def read_header(file: InputFile) -> tuple[Header, int]:
    """The header, and the offset behind it. Raises Damaged if this is no MCAP file."""
    if file.size == 0:
        raise Damaged("it is empty")
    if file.size < len(MAGIC) or file.read(0, len(MAGIC)) != MAGIC:
        raise Damaged("it is no MCAP file")
    opcode, length = read_record_head(file, len(MAGIC))
    if opcode != Opcode.HEADER:
        raise Damaged("it does not begin with a header")
    header = parse(Header, read_content(file, len(MAGIC), length))
    return header, len(MAGIC) + RECORD_HEAD.size + length
