"""Read the records of an MCAP file that may be damaged or hostile.

Any damage raises `Damaged`. Every length is checked before memory is allocated.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple, Self, TypeVar

from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Header, McapRecord

from robotctl.recording.format.records import MAGIC
from robotctl.recording.format.records import RECORD_HEAD as RECORD_HEAD
from robotctl.recording.read.files import Source, open_source
from robotctl.recording.read.read_limits import (
    BYTES_PER_RECORD,
    RECORDS,
    BeyondLimit,
    Damaged,
    ReadLimits,
    Unreadable,
    note_read_failure,
)

MESSAGE_FIELDS: Final = struct.Struct("<HIQQ")
"""Channel id, sequence, log time [ns] and publish time [ns], before a message's data."""

_MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""RECORD_HEAD and MESSAGE_FIELDS."""

RecordHead = tuple[int, int, int, int, int, int]
"""Opcode, content length [bytes] and MESSAGE_FIELDS, which are valid for messages only."""

HeadBlock = list[tuple[int, RecordHead]]
"""Position and head of each record in a part of a chunk."""

_PIECE_BYTES: Final = 1 << 20
_BLOCK_RECORDS: Final = 512
_BLOCK_BYTES: Final = 1 << 20
"""A block of a chunk ends after _BLOCK_RECORDS records or this many bytes."""

MAX_RECORD_BYTES: Final = 64 << 20
"""Maximum content of a schema, channel, metadata or index record. A larger one is damage."""

TOO_MANY_RECORDS: Final = (
    f"it holds more than {RECORDS} messages, and more than one for every {BYTES_PER_RECORD} bytes"
)

_ATTACHMENT_FIXED_BYTES: Final = 8 + 8 + 4 + 4 + 8
"""Log time, create time, lengths of name and media type, size of the data."""

_Record = TypeVar("_Record", bound=McapRecord)


class _ExactStream(ReadDataStream):
    """A stream that raises EndOfFile if there is too little data."""

    def read(self, length: int) -> bytes:
        data: bytes = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(kind: type[_Record], data: bytes) -> _Record:
    """Return the record whose content, without opcode and length, is `data`.

    Raises:
        Damaged: The content is malformed.
    """
    try:
        return kind.read(_ExactStream(BytesIO(data)))  # type: ignore[attr-defined,no-any-return]
    except (McapError, ValueError, struct.error, OverflowError) as error:
        raise Damaged(f"a {kind.__name__.lower()} record is malformed") from error


class Record(NamedTuple):
    """The place of a record. `end` is the offset after it, perhaps beyond the end of the file."""

    opcode: int
    offset: int
    end: int

    @property
    def content(self) -> int:
        """The offset of the content."""
        return self.offset + RECORD_HEAD.size

    @property
    def length(self) -> int:
        """The length of the content [bytes]."""
        return self.end - self.content


class InputFile:
    """A file, perhaps growing, that is read at offsets."""

    def __init__(
        self,
        path: Path,
        on_progress: Callable[[int, int], None] = lambda done, total: None,
        source: Source | None = None,
    ) -> None:
        """Open the regular file `path` or, if given, `source` under the name `path`.

        `on_progress` gets bytes done and in total while a `.mcap.zstd` is decompressed.

        Raises:
            OSError: The file cannot be opened.
            Damaged: The file cannot be decompressed.
        """
        self.path = path
        self.failure: Unreadable | None = None
        """The first failure of disk or memory."""

        try:
            self._source = source or open_source(path, on_progress)
        except OSError as error:
            note_read_failure(f"{path}: {error.strerror or error}")
            raise
        self.size = 0
        self.stored_bytes = 0
        """The size on the disk [bytes], which determines the limits."""

        try:
            self.refresh()
        except BaseException:
            self.close()
            raise

    def refresh(self) -> None:
        """Read the file's present size, and set the read limits that follow from it."""
        self.size = self._source.size()
        self.stored_bytes = self._source.stored_bytes()
        self.limits = ReadLimits.of(self.stored_bytes)

    def is_changing(self) -> bool:
        """Return whether a process is writing the file, or its size has changed since `refresh`."""
        return self._source.size() != self.size or self._source.is_written()

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes at `offset`.

        Raises:
            Damaged: The file ends before that, or the disk fails.
            UnreadableFile: The store of the file fails.
        """
        if offset < 0 or length < 0 or offset + length > self.size:
            raise Damaged(f"it ends at byte {self.size}, in the middle of a record")
        try:
            data = self._source.read(offset, length)
            while len(data) < length:
                more = self._source.read(offset + len(data), length - len(data))
                if not more:
                    raise Damaged(
                        f"it was truncated at byte {offset + len(data)} while it was read"
                    )
                data += more
        except OSError as error:
            reason = f"the disk cannot read it at byte {offset}: {error.strerror or error}"
            raise self.failed(reason) from error
        return data

    def pieces(self, start: int, end: int) -> Iterator[bytes]:
        """Yield the bytes from `start` to `end` in pieces.

        Raises:
            Damaged: The file ends before `end`, or the disk fails.
        """
        for offset in range(start, end, _PIECE_BYTES):
            yield self.read(offset, min(_PIECE_BYTES, end - offset))

    def record(self, offset: int) -> Record:
        """Return place and opcode of the record at `offset`.

        Raises:
            Damaged: The file ends inside the opcode or the length of the record.
        """
        opcode, length = RECORD_HEAD.unpack(self.read(offset, RECORD_HEAD.size))
        return Record(opcode, offset, offset + RECORD_HEAD.size + length)

    def content(self, record: Record) -> bytes:
        """Return the content of a record other than a chunk or an attachment.

        Raises:
            Damaged: The file ends within the record, or the record is over MAX_RECORD_BYTES.
        """
        if record.length > MAX_RECORD_BYTES:
            raise Damaged(f"a record at byte {record.offset} claims {record.length} bytes")
        return self.read(record.content, record.length)

    def failed(self, reason: str) -> Unreadable:
        """Note a failure of disk or memory, and return its error."""
        note_read_failure(f"{self.path}: {reason}")
        failure = Unreadable(reason)
        self.failure = self.failure or failure
        return failure

    def close(self) -> None:
        """Close the file. Closing twice is harmless."""
        self._source.close()

    def __enter__(self) -> Self:
        """Return the file."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()


def walk_records(data: bytes, most: int = sys.maxsize) -> Iterator[tuple[int, int, int]]:
    """Yield each record of a chunk or summary as opcode, begin and end of its content in `data`.

    Raises:
        Damaged: A record is cut off or malformed.
        BeyondLimit: There are more than `most` records.
    """
    for block in head_blocks(data, most):
        for position, head in block:
            start = position + RECORD_HEAD.size
            yield head[0], start, start + head[1]


def head_blocks(data: bytes, most: int = sys.maxsize) -> Iterator[HeadBlock]:
    """Yield the records of a chunk or summary, `data`, in lists of (position, record head).

    Raises:
        Damaged: A record is cut off or malformed. All records before it were yielded.
        BeyondLimit: There are more than `most` records.
    """
    position, size = 0, len(data)
    last_message, least_bytes = size - _MESSAGE_HEAD.size, MESSAGE_FIELDS.size
    unpack, message, head_bytes = _MESSAGE_HEAD.unpack_from, Opcode.MESSAGE.value, RECORD_HEAD.size
    while position < size:
        if most <= 0:
            raise BeyondLimit(TOO_MANY_RECORDS)
        block: HeadBlock = []
        add, block_end = block.append, min(position + _BLOCK_BYTES, size)
        last_quick = min(last_message, block_end - 1)
        try:
            for _ in range(min(most, _BLOCK_RECORDS)):
                if position <= last_quick:
                    head = unpack(data, position)
                elif position < block_end:
                    head = _short_head(data, position)
                else:
                    break
                end = position + head_bytes + head[1]
                if end > size or (head[1] < least_bytes and head[0] == message):
                    raise Damaged("a chunk ends in the middle of a record")
                if head[0] == 0:
                    raise Damaged("a chunk holds zeros in the place of a record")
                add((position, head))
                position = end
        except Damaged:
            yield block
            raise
        yield block
        most -= len(block)


def _short_head(data: bytes, position: int) -> RecordHead:
    """Return the head of a record too near to the end to be a message."""
    if position + RECORD_HEAD.size > len(data):
        raise Damaged("a chunk ends in the middle of a record")
    opcode, length = RECORD_HEAD.unpack_from(data, position)
    return opcode, length, 0, 0, 0, 0


LOST_HEADER: Final = Header(profile="", library="")
"""The result for a header of zeros, which a power cut can cause."""

ZEROS: Final = "it is not an MCAP file: it begins with zeros"


def read_header(file: InputFile) -> tuple[Header, int]:
    """Return the header, LOST_HEADER if the file begins with zeros, and the offset after it.

    Raises:
        Damaged: The file is empty, or no MCAP file.
    """
    if file.size == 0:
        raise Damaged("it is empty")
    if not any(file.read(0, min(file.size, len(MAGIC) + RECORD_HEAD.size))):
        return LOST_HEADER, len(MAGIC)
    if file.size < len(MAGIC) or file.read(0, len(MAGIC)) != MAGIC:
        raise Damaged("it is not an MCAP file")
    record = file.record(len(MAGIC))
    if record.opcode != Opcode.HEADER:
        raise Damaged("it does not begin with a header")
    return parse(Header, file.content(record)), record.end


def read_attachment(file: InputFile, offset: int) -> Attachment:
    """Return the attachment whose record is at `offset`.

    Raises:
        Damaged: There is no attachment, its checksum is wrong, or it is too large.
    """
    record, most = file.record(offset), file.limits.attachment_bytes
    if record.opcode != Opcode.ATTACHMENT:
        raise Damaged("there is no attachment")
    if record.length > most:
        raise BeyondLimit(f"it has {record.length} bytes, more than {most}")
    content = file.read(record.content, record.length)
    attachment: Attachment = parse(Attachment, content)
    texts = len(attachment.name.encode()) + len(attachment.media_type.encode())
    covered = _ATTACHMENT_FIXED_BYTES + texts + len(attachment.data)
    # A later version of the format may add fields after the checksum.
    crc = int.from_bytes(content[covered : covered + 4], "little")
    if crc and crc != crc32(memoryview(content)[:covered]):
        raise Damaged("its checksum is wrong")
    return attachment
