"""Read a whole file, and check each byte of it.

Bytes that a killed recorder leaves after the last commit are no flaw.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from hashlib import sha256
from math import isqrt
from pathlib import Path

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer

from robotctl.base.errors import UnreadableFile
from robotctl.recording.format.records import DATA_END_BYTES, FOOTER_CONTENT_BYTES, MAGIC
from robotctl.recording.format.seal_records import (
    LINK_OPCODE,
    MAX_OPENING_BYTES,
    OPENING_OPCODE,
    Link,
    LinkKind,
    Opening,
    chained,
)
from robotctl.recording.format.trailer import FOOTER_BYTES
from robotctl.recording.read.files import reason_of
from robotctl.recording.read.indexing import (
    find_unfinished_commit,
    index_from_summary,
    read_summary,
    read_written_file,
)
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import RECORD_HEAD, InputFile, Record, parse, walk_records
from robotctl.recording.read.whole_data import (
    FileState,
    Flaws,
    WholeData,
    compare_summary,
    read_data_section,
)
from robotctl.recording.seal import is_signed


class SealState(StrEnum):
    """How much of a file its seal proves."""

    SEALED = "sealed"
    """The whole file."""

    PARTLY = "partly sealed"
    """Only the beginning, because of a repair or because the recorder could no longer sign."""

    NONE = "not sealed"
    BROKEN = "broken"


@dataclass(slots=True)
class SealOfRead:
    """The result of `check_seal`. `links` has the valid links in order."""

    opening: Opening | None = None
    links: list[Link] = field(default_factory=list)
    is_copy: bool = False
    """Whether a repair copied the file from a sealed one. Nothing in it is signed."""

    state: SealState = SealState.NONE
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def head(self) -> Link | None:
        """The newest valid link, None without one."""
        return self.links[-1] if self.links else None

    def knows(self, digest: str) -> bool:
        """Return whether a valid link has this digest, in hex."""
        return any(link.digest.hex() == digest for link in self.links)


def check_seal(file: InputFile, data: WholeData, state: FileState, loose: int) -> SealOfRead:
    """Check the seal of a file with the content `data`. The last `loose` bytes need no seal.

    Raises:
        Damaged: The disk fails.
    """
    found = SealOfRead()
    try:
        opening, links = _records(file, data)
    except ValueError as error:
        found.wrong.append(str(error))
        found.state = SealState.BROKEN
        return found
    found.opening = opening
    if opening is None:
        if links:
            found.wrong.append("links of a seal are there without the record that opens it")
            found.state = SealState.BROKEN
        elif state is FileState.CONVERTED:
            found.notes.append("it was converted: a seal of the original does not hold for it")
        return found
    if not is_signed(opening.signed(), bytes.fromhex(opening.certificate), opening.previous_key):
        found.wrong.append("the key of the file is not signed by the key of the file before")
    _check_links(file, opening, links, found)
    _judge(data.end - min(loose, data.end), state, links, found)
    return found


def _records(file: InputFile, data: WholeData) -> tuple[Opening | None, list[Link]]:
    """Return the records of the seal.

    Raises:
        ValueError: A record is malformed, or there are two openings.
    """
    opening: Opening | None = None
    links: list[Link] = []
    for record in data.private:
        opcode, offset, _ = record
        if opcode not in (OPENING_OPCODE, LINK_OPCODE):
            continue
        if record.length > MAX_OPENING_BYTES:
            raise ValueError(f"a record of the seal has {record.length} bytes")
        content = file.content(record)
        if opcode == LINK_OPCODE:
            link = Link.read(content)
            if link.covered > offset or (link.kind is LinkKind.LINK and link.covered != offset):
                raise ValueError(f"the link at byte {offset} covers other bytes")
            links.append(link)
        elif opening is None:
            opening = Opening.read(content)
        else:
            raise ValueError("the seal is opened twice")
    heads = [Link.read(content) for opcode, content in data.private_in_summary]
    if len(heads) > 1 or any(link.kind is not LinkKind.HEAD for link in heads):
        raise ValueError("the summary holds another link than the head")
    return opening, links + heads


def _check_links(file: InputFile, opening: Opening, links: list[Link], found: SealOfRead) -> None:
    """Compute the hash chain, and compare each link up to the first wrong one."""
    base, start, number = bytes.fromhex(opening.previous), 0, 1
    running, position = sha256(), 0
    for link in links:
        if link.kind is LinkKind.REPAIRED:
            continue
        where = f"between byte {start} and {link.covered}"
        if link.covered < position or link.number != number or link.covered > file.size:
            found.wrong.append(f"the links of the seal are not in their order {where}")
            return
        for piece in file.pieces(position, link.covered):
            running.update(piece)
        position = link.covered
        if chained(base, running.digest()) != link.digest:
            found.wrong.append(f"the chain is broken {where}: these bytes are not those signed for")
            return
        if not is_signed(link.signed(), link.signature, opening.key):
            found.wrong.append(f"the signature of the bytes {where} is not by the key of the file")
            return
        found.links.append(link)
        if link.kind is LinkKind.LINK:
            base, start, number, running = link.digest, link.covered, number + 1, sha256()


def _judge(end: int, state: FileState, links: list[Link], found: SealOfRead) -> None:
    repaired = any(link.kind is LinkKind.REPAIRED for link in links)
    found.is_copy = repaired and found.head is None
    if found.wrong:
        found.state = SealState.BROKEN
    elif found.head is not None and found.head.covered >= end and not repaired:
        found.state = SealState.SEALED
    elif found.is_copy:
        found.notes.append("a repair copied it from a sealed file: nothing in it is signed")
    elif found.head is None:
        found.notes.append("it was to be sealed, but no link was signed")
    else:
        found.state = SealState.PARTLY
        why = "a repair has written the rest" if repaired else "the rest is not signed for"
        found.notes.append(f"sealed are the first {found.head.covered} bytes: {why}")
        if state is FileState.FINISHED and not repaired:
            found.notes.append("the recorder stopped signing, or a signature was removed")


def find_footer(file: InputFile, data_end: int) -> Record:
    """Return the footer of the trailer whose DataEnd record is at `data_end`.

    Raises:
        Damaged: There is no footer of the right length, or the file ends before it.
    """
    offset = data_end
    while True:
        if offset + RECORD_HEAD.size > file.size:
            raise Damaged("it ends without a footer")
        record = file.record(offset)
        if record.end > file.size:
            raise Damaged(f"a record claims to have {record.length} bytes")
        if offset == data_end and record.end != data_end + DATA_END_BYTES:
            raise Damaged("the record that ends the data has another length")
        if record.opcode == Opcode.FOOTER:
            break
        offset = record.end
    if record.length != FOOTER_CONTENT_BYTES:
        raise Damaged("the footer has another length")
    if record.end + len(MAGIC) > file.size:
        raise Damaged("it ends within the mark of MCAP")
    return record


def ends_in_commit(file: InputFile, summary_start: int, end: int) -> bool:
    """Return whether the bytes after `end`, the trailer's end, are of an interrupted write."""
    try:
        last = file.read(file.size - FOOTER_BYTES, FOOTER_BYTES)
        if RECORD_HEAD.unpack_from(last) != (Opcode.FOOTER, FOOTER_CONTENT_BYTES):
            return False
        footer = parse(Footer, last[RECORD_HEAD.size : -len(MAGIC)])
    except Damaged:
        return False
    # `McapFile` writes such a footer first when it moves the trailer.
    points_back = footer.summary_start == summary_start and not footer.summary_crc
    return last.endswith(MAGIC) and (points_back or footer.summary_start > end)


def forget_unlisted_chunk(data: WholeData, summary: bytes) -> int:
    """Remove the last chunk from `data` if `summary` lacks it. Return its size [bytes], else 0."""
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
"""Time of retries to read the end of a growing file."""

_LOOK_AGAIN_S = 0.002


@dataclass(slots=True)
class WholeFile:
    """What `read_whole_file` found. `loose` counts the bytes of a write that a kill interrupted."""

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
        """Return a sentence for each kept flaw, and one with the number of other flaws."""
        more = self.flaws.count - len(self.flaws.kept)
        found = [flaw.sentence() for flaw in self.flaws.kept]
        return [*found, f"and {more} more"] if more else found


def read_whole_file(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> WholeFile:
    """Read every byte of an MCAP file, and check its seal.

    Raises:
        UnreadableFile: The file is not an MCAP file, or the disk cannot read it.
    """
    try:
        with InputFile(path, on_progress) as file:
            found = _check_bytes(file, on_progress)
            found.seal = check_seal(file, found.data, found.state, found.loose)
            return found
    except (OSError, Damaged) as error:
        reason = reason_of(error) if isinstance(error, OSError) else error
        raise UnreadableFile(f"{path} cannot be read: {reason}") from error


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
            summary, start = read_summary(file)
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
    compare_summary(summary, start, data, flaws)
    return found


def _check_crc(file: InputFile, found: WholeFile) -> None:
    """Check the CRC of the data, and name the byte if one flipped bit explains a difference."""
    data, flaws = found.data, found.flaws
    if data.told_crc:
        span = 0, data.end + DATA_END_BYTES
        crcs = data.told_crc, data.crc
        _compare_crcs("data", crcs, (0, data.end), span, flaws, place_known=bool(flaws.count))
    elif data.crc and data.own and found.state is not FileState.NOT_CLOSED:
        flaws.add(data.end, data.end + DATA_END_BYTES, "the data has no checksum")


def _compare_crcs(
    what: str,
    crcs: tuple[int, int],
    covered: tuple[int, int],
    span: tuple[int, int],
    flaws: Flaws,
    *,
    place_known: bool,
) -> None:
    """Compare the CRCs (stored, computed) of the bytes `covered` (start, end).

    The flaw is the byte in which one flipped bit explains it, else `span` (none if `place_known`).
    """
    told, found = crcs
    start, end = covered
    if told == found:
        return
    at = find_flip(told, found, end - start)
    if at is None:
        if not place_known:
            flaws.add(*span, f"the checksum of the {what} is wrong")
        return
    bit = "one bit of this byte" if what == "data" else "a bit"
    flaws.add(start + at, start + at + 1, f"the checksum of the {what} tells that {bit} is wrong")


def _check_trailer(file: InputFile, found: WholeFile) -> None:
    """Check everything from DataEnd to the end of the file."""
    data, flaws = found.data, found.flaws
    try:
        footer = find_footer(file, data.end)
    except Damaged as damage:
        if file.failure:
            raise
        flaws.add(data.end, file.size, f"the end of the file: {damage}")
        return
    before, start, end = flaws.count, data.end + DATA_END_BYTES, footer.end + len(MAGIC)
    summary = file.read(start, footer.offset - start)
    if data.unfinished is not None:
        found.loose += data.end - data.unfinished
    if found.state is FileState.NOT_CLOSED and not data.told_crc:
        found.loose += forget_unlisted_chunk(data, summary)
    if summary or data.own:
        compare_summary(summary, start, data, flaws)
    told: Footer = parse(Footer, file.content(footer))
    if (data.own or told.summary_start) and told.summary_start != start:
        flaws.add(footer.offset, footer.end, "the footer says that the summary begins elsewhere")
    if file.read(footer.end, len(MAGIC)) != MAGIC:
        flaws.add(footer.end, end, "the file does not end with the mark of MCAP")
    if end != file.size:
        if found.state is FileState.NOT_CLOSED and ends_in_commit(file, start, end):
            found.loose += file.size - end
        else:
            flaws.add(end, file.size, "these bytes lie behind the end of the file")
    if told.summary_crc or data.own:
        covered, span = (start, footer.end - _CRC_BYTES), (start, footer.end)
        crcs = told.summary_crc, crc32(file.read(start, covered[1] - start))
        known = flaws.count > before
        _compare_crcs("summary", crcs, covered, span, flaws, place_known=known)


def find_flip(told: int, found: int, size: int) -> int | None:
    """Return the offset of the byte in which one flipped bit explains a wrong CRC-32, or None.

    `told` is the stored CRC-32, `found` that of the `size` bytes read. 100 MB take 0.1 s.
    """
    if told == found or size > MAX_FLIP_BYTES:
        return None
    # A CRC is linear: the effect of a bit depends only on the number of bytes behind it.
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
