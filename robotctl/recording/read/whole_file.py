"""Reads a whole file: is each byte part of a record, and is it as it was written?

A file of robotctl has only one form for its content: each bit is covered by a checksum or
determined by the others. Bytes that a killed recorder leaves after the last commit are no flaw.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isqrt
from pathlib import Path
from typing import NamedTuple

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer

from robotctl.base.errors import UnreadableFile
from robotctl.recording.format.records import DATA_END_BYTES, FOOTER_CONTENT_BYTES, MAGIC
from robotctl.recording.format.trailer import FOOTER_BYTES
from robotctl.recording.read.files import reason_of
from robotctl.recording.read.indexing import (
    find_unfinished_commit,
    index_from_summary,
    read_written_file,
)
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import RECORD_HEAD, InputFile, parse, walk_records
from robotctl.recording.read.seal_check import SealOfRead, check_seal
from robotctl.recording.read.whole_data import (
    FileState,
    Flaws,
    WholeData,
    compare_summary,
    read_data_section,
)


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

    The wrong byte is not known: after a changed length, the reader continues in the middle of
    another record, and fails only later.
    """


def find_end(file: InputFile, data_end: int) -> FileEnd:
    """Return the end that follows the DataEnd record at `data_end`.

    Raises:
        BadEnd: There is no footer of the right length, or the file ends before it.
        Damaged: The disk fails.
    """
    offset, summary = data_end, data_end + DATA_END_BYTES
    while True:
        if offset + RECORD_HEAD.size > file.size:
            raise BadEnd("it ends without a footer")
        record = file.record(offset)
        if record.end > file.size:
            raise BadEnd(f"a record claims to have {record.length} bytes")
        if offset == data_end and record.end != summary:
            raise BadEnd("the record that ends the data has another length")
        if record.opcode == Opcode.FOOTER:
            break
        offset = record.end
    if record.length != FOOTER_CONTENT_BYTES:
        raise BadEnd("the footer has another length")
    if record.end + len(MAGIC) > file.size:
        raise BadEnd("it ends within the mark of MCAP")
    return FileEnd(summary, offset, record.end)


def ends_in_commit(file: InputFile, end: FileEnd) -> bool:
    """Return whether the bytes after `end` are the beginning of a commit that a kill interrupted.

    Such a file ends with a footer that points back to this end or to a copy of it: the writer
    writes that footer first (see `McapFile`).
    """
    try:
        last = file.read(file.size - FOOTER_BYTES, FOOTER_BYTES)
        if RECORD_HEAD.unpack_from(last) != (Opcode.FOOTER, FOOTER_CONTENT_BYTES):
            return False
        footer = parse(Footer, last[RECORD_HEAD.size : -len(MAGIC)])
    except Damaged:
        return False
    points_back = footer.summary_start == end.summary and not footer.summary_crc
    return last.endswith(MAGIC) and (points_back or footer.summary_start > end.after)


def forget_unlisted_chunk(data: WholeData, summary: bytes) -> int:
    """Remove the last chunk from `data` if the summary does not list it; return its size [bytes].

    A kill between writing the chunk and the summary leaves such a chunk.
    """
    chunks = data.listed[Opcode.CHUNK_INDEX]
    if not chunks:
        return 0
    last = max(chunks)
    try:
        listed = {
            parse(ChunkIndex, summary[start:end]).chunk_start_offset
            for opcode, start, end in walk_records(summary)
            if opcode == Opcode.CHUNK_INDEX
        }
    except Damaged:
        return 0
    entry: ChunkIndex = chunks[last]
    end = last + entry.chunk_length + entry.message_index_length
    if last in listed or end != (data.end if data.unfinished is None else data.unfinished):
        return 0
    del chunks[last]
    data.counts, data.start_ns, data.end_ns = data.before_last_chunk
    return end - last


_CRC_BYTES = 4
_ONES = (1 << 32) - 1

MAX_FLIP_BYTES = 1 << 28
"""In larger data, flips of different bits may change a CRC-32 in the same way."""

_GROWING_S = 2.0
"""How long reading the end of a growing file is retried."""

_LOOK_AGAIN_S = 0.002


@dataclass(slots=True)
class WholeFile:
    """What reading every byte of a file found, and its seal.

    `flaws` is empty if the file is whole. `loose` counts the bytes of a commit that a kill
    interrupted: they are no part of the recording.
    """

    path: Path
    size: int
    state: FileState
    data: WholeData
    flaws: Flaws = field(default_factory=Flaws)
    loose: int = 0
    seal: SealOfRead = field(default_factory=SealOfRead)

    @property
    def whole(self) -> bool:
        """Whether every byte was read, and none is wrong."""
        return not self.flaws.count and not self.data.unread

    def flaw_sentences(self) -> list[str]:
        """Return a sentence for each flaw that is kept, and for the number of further ones."""
        more = self.flaws.count - len(self.flaws.kept)
        found = [flaw.sentence() for flaw in self.flaws.kept]
        return [*found, f"and {more} more"] if more else found


def read_whole_file(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> WholeFile:
    """Read every byte of an MCAP file, and check its seal.

    `on_progress` gets bytes done and in total.

    Raises:
        UnreadableFile: It is not an MCAP file, or the disk cannot read it.
    """
    try:
        with InputFile(path, on_progress) as file:
            found = _check_bytes(file, on_progress)
            found.seal = check_seal(file, found.data, found.state, found.loose)
            return found
    except OSError as error:
        raise UnreadableFile(f"{path} cannot be read: {reason_of(error)}") from error
    except Damaged as damage:
        raise UnreadableFile(f"{path} cannot be read: {damage}") from damage


def _check_bytes(file: InputFile, on_progress: Callable[[int, int], None]) -> WholeFile:
    """Read every byte of an open file.

    Raises:
        Damaged: The file does not begin as an MCAP file, or the disk fails.
    """
    if file.is_changing():
        return _live(file, Flaws(), lambda offset: on_progress(offset, file.size))
    flaws = Flaws()
    data = read_data_section(file, flaws, on_progress=lambda offset: on_progress(offset, file.size))
    found = WholeFile(file.path, file.size, data.state(), data, flaws)
    if data.told_crc is None:
        if not flaws.count and not data.unread:
            flaws.add(data.end, file.size, "the file was never finished")
        return found
    _check_crc(file, found)
    _check_trailer(file, found)
    return found


def _live(file: InputFile, flaws: Flaws, on_progress: Callable[[int], None]) -> WholeFile:
    """Read a growing file up to the end that its summary gives."""
    deadline = time.monotonic() + _GROWING_S
    while True:
        try:
            index, written = index_from_summary(file), read_written_file(file)
            if index.limit_reached:
                raise Damaged("; ".join(index.missing))
            end = find_unfinished_commit(file, index, written.data_end)
            if read_written_file(file) == written:
                break
        except Damaged:
            if time.monotonic() > deadline:
                raise
        time.sleep(_LOOK_AGAIN_S)
    end = written.data_end if end is None else end
    data = read_data_section(file, flaws, end, on_progress)
    found = WholeFile(file.path, end, FileState.LIVE, data, flaws)
    data.told_crc = written.data_crc
    if written.data_crc:  # otherwise a commit was just being written
        _check_crc(file, found)
    groups = dict(written.groups)
    offsets = groups.pop(Opcode.SUMMARY_OFFSET, b"")
    summary = b"".join([*groups.values(), written.seal, offsets])
    compare_summary(summary, written.data_end + DATA_END_BYTES, data, flaws)
    return found


def _check_crc(file: InputFile, found: WholeFile) -> None:
    """Compare the CRC of the data; if one flipped bit explains a difference, name its byte."""
    data, flaws = found.data, found.flaws
    if data.told_crc == data.crc:
        return
    if not data.told_crc:
        if data.own and found.state is not FileState.NOT_CLOSED:
            flaws.add(data.end, data.end + DATA_END_BYTES, "the data has no checksum")
        return
    at = find_flip(data.told_crc or 0, data.crc, data.end)
    if at is not None:
        flaws.add(at, at + 1, "the checksum of the data tells that one bit of this byte is wrong")
    elif not flaws.count:
        flaws.add(0, data.end + DATA_END_BYTES, "the checksum of the data is wrong")


def _check_trailer(file: InputFile, found: WholeFile) -> None:
    """Check everything from DataEnd to the end of the file."""
    data, flaws = found.data, found.flaws
    try:
        end = find_end(file, data.end)
    except BadEnd as damage:
        flaws.add(data.end, file.size, f"the end of the file: {damage}")
        return
    before = flaws.count
    summary = file.read(end.summary, end.footer - end.summary)
    if data.unfinished is not None:
        found.loose += data.end - data.unfinished
    if found.state is FileState.NOT_CLOSED and not data.told_crc:
        found.loose += forget_unlisted_chunk(data, summary)
    if summary or data.own:
        compare_summary(summary, end.summary, data, flaws)
    footer: Footer = parse(Footer, file.read(end.footer + RECORD_HEAD.size, FOOTER_CONTENT_BYTES))
    if (data.own or footer.summary_start) and footer.summary_start != end.summary:
        flaws.add(end.footer, end.magic, "the footer says that the summary begins elsewhere")
    if file.read(end.magic, len(MAGIC)) != MAGIC:
        flaws.add(end.magic, end.after, "the file does not end with the mark of MCAP")
    if end.after != file.size:
        if found.state is FileState.NOT_CLOSED and ends_in_commit(file, end):
            found.loose += file.size - end.after
        else:
            flaws.add(end.after, file.size, "these bytes lie behind the end of the file")
    _check_summary_crc(file, found, end, footer, place_known=flaws.count > before)


def _check_summary_crc(
    file: InputFile, found: WholeFile, end: FileEnd, footer: Footer, *, place_known: bool
) -> None:
    if not footer.summary_crc and not found.data.own:
        return
    size = end.magic - _CRC_BYTES - end.summary
    crc = crc32(file.read(end.summary, size))
    if crc == footer.summary_crc:
        return
    at = find_flip(footer.summary_crc, crc, size)
    if at is not None:
        start = end.summary + at
        found.flaws.add(start, start + 1, "the checksum of the summary tells that a bit is wrong")
    elif not place_known:
        found.flaws.add(end.summary, end.magic, "the checksum of the summary is wrong")


def find_flip(told: int, found: int, size: int) -> int | None:
    """Return the offset of the byte in which one flipped bit explains the difference, or None.

    `told` and `found` are CRC-32s of `size` bytes. A CRC is linear: the effect of a bit depends on
    the number of bytes behind it. The search, in steps of the root of `size`, takes 0.1 s for
    100 MB.
    """
    if told == found or size > MAX_FLIP_BYTES:
        return None
    step = isqrt(size) + 1
    zeros, behind_of = bytes(step), dict[int, int]()
    for bit in range(8):
        effect = crc32(bytes([1 << bit])) ^ crc32(b"\0")
        for behind in range(0, size + step, step):
            behind_of[effect] = behind
            effect = crc32(zeros, effect ^ _ONES) ^ _ONES
    effect = told ^ found
    for nearer in range(step):
        behind = behind_of.get(effect, -1) - nearer
        if 0 <= behind < size:
            return size - 1 - behind
        effect = crc32(b"\0", effect ^ _ONES) ^ _ONES
    return None
