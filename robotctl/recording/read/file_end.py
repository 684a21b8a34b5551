"""The end of a file, found by walking there from the end of its data."""

from __future__ import annotations

from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, MetadataIndex

from robotctl.recording.format.records import DATA_END_BYTES, FOOTER_CONTENT_BYTES, MAGIC
from robotctl.recording.format.seal_records import LINK_OPCODE, OPENING_OPCODE
from robotctl.recording.format.trailer import WrittenFile
from robotctl.recording.read.chunk_index import read_chunk_index
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import read_header, read_record_head
from robotctl.recording.read.mcap_input import RECORD_HEAD, InputFile, parse, walk_records
from robotctl.recording.read.whole_data import WholeData

_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_ID_BYTES = 2


class FileEnd(NamedTuple):
    """Where the parts of a file's end begin [bytes]."""

    summary: int
    footer: int
    magic: int

    @property
    def after(self) -> int:
        """The offset after the end."""
        return self.magic + len(MAGIC)


class BadEnd(Damaged):
    """There is no valid end.

    Where it is wrong is not known: a changed length leads into the middle of another record, and
    the walk goes astray only later.
    """


def find_end(file: InputFile, data_end: int) -> FileEnd:
    """Return where the end is that follows the DataEnd record at `data_end`.

    Raises:
        BadEnd: There is no footer of the right length, or the file ends before it.
        Damaged: The disk fails.
    """
    offset, summary = data_end, data_end + DATA_END_BYTES
    while True:
        if offset + RECORD_HEAD.size > file.size:
            raise BadEnd("it ends without a footer")
        opcode, length = RECORD_HEAD.unpack(file.read(offset, RECORD_HEAD.size))
        after = offset + RECORD_HEAD.size + length
        if after > file.size:
            raise BadEnd(f"a record claims to have {length} bytes")
        if offset == data_end and after != summary:
            raise BadEnd("the record that ends the data has another length")
        if opcode == Opcode.FOOTER:
            break
        offset = after
    if length != FOOTER_CONTENT_BYTES:
        raise BadEnd("the footer has another length")
    if after + len(MAGIC) > file.size:
        raise BadEnd("it ends within the mark of MCAP")
    return FileEnd(summary, offset, after)


def end_of_listed(file: InputFile, written: WrittenFile) -> int:
    """Return where the data of a growing file ended when its summary was written.

    Behind it there may be records of the next commit, and the room for more.

    Raises:
        Damaged: The summary or the file cannot be read.
    """
    _, offset = read_header(file)
    groups = written.groups
    for _, start, end in walk_records(groups.get(Opcode.METADATA_INDEX, b"")):
        metadata = parse(MetadataIndex, groups[Opcode.METADATA_INDEX][start:end])
        offset = max(offset, metadata.offset + metadata.length)
    chunks = groups.get(Opcode.CHUNK_INDEX, b"")
    for _, start, end in walk_records(chunks):
        offset = max(offset, read_chunk_index(chunks, start, end).end)
    defined = {
        (opcode, groups[opcode][start : start + _ID_BYTES])
        for opcode in _DEFINITIONS
        for _, start, _ in walk_records(groups.get(opcode, b""))
    }
    while offset < written.data_end:
        opcode, length = read_record_head(file, offset)
        content = offset + RECORD_HEAD.size
        if opcode in _DEFINITIONS:
            if (opcode, file.read(content, _ID_BYTES)) not in defined:
                break
        elif opcode not in (OPENING_OPCODE, LINK_OPCODE):
            break
        offset = content + length
    return offset


def ends_in_commit(file: InputFile, end: FileEnd) -> bool:
    """Return whether the bytes behind `end` are the beginning of a commit that a kill interrupted.

    Such a file ends with a footer that points back to this end, or to a copy of it: the writer puts
    it there first (see `McapFile`).
    """
    size = RECORD_HEAD.size + FOOTER_CONTENT_BYTES
    try:
        last = file.read(file.size - size - len(MAGIC), size + len(MAGIC))
        if RECORD_HEAD.unpack_from(last) != (Opcode.FOOTER, FOOTER_CONTENT_BYTES):
            return False
        footer: Footer = parse(Footer, last[RECORD_HEAD.size : size])
    except Damaged:
        return False
    points_back = footer.summary_start == end.summary and not footer.summary_crc
    return last.endswith(MAGIC) and (points_back or footer.summary_start > end.after)


def forget_unlisted_chunk(data: WholeData, summary: bytes) -> int:
    """Take the last chunk out of `data` if the summary does not list it; return its bytes.

    A kill between chunk and summary leaves that.
    """
    if not data.chunk_indexes:
        return 0
    last = max(data.chunk_indexes)
    try:
        listed = {
            parse(ChunkIndex, summary[start:end]).chunk_start_offset
            for opcode, start, end in walk_records(summary)
            if opcode == Opcode.CHUNK_INDEX
        }
    except Damaged:
        return 0
    entry = data.chunk_indexes[last]
    end = last + entry.chunk_length + entry.message_index_length
    if last in listed or end != (data.end if data.unfinished is None else data.unfinished):
        return 0
    del data.chunk_indexes[last]
    data.counts, data.start_ns, data.end_ns = data.before_last_chunk
    return end - last
