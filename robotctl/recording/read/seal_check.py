"""Checks the seal of a file: the chain over its bytes, the signatures, and who made them.

The data must have been read: the chain alone does not show whether each byte is in a record.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from hashlib import sha256

from robotctl.recording.format.seal_records import (
    LINK_OPCODE,
    MAX_OPENING_BYTES,
    OPENING_OPCODE,
    Link,
    LinkKind,
    Opening,
    chained,
)
from robotctl.recording.read.records import InputFile
from robotctl.recording.read.whole_data import FileState, WholeData
from robotctl.recording.seal.keyring import is_signed


class SealState(StrEnum):
    """What the seal of a file covers."""

    SEALED = "sealed"
    """The whole file."""

    PARTLY = "partly sealed"
    """The beginning: a repair wrote the rest, or the recorder could no longer sign."""

    NONE = "not sealed"
    BROKEN = "broken"


@dataclass(slots=True)
class SealOfRead:
    """The seal of a file, as it was checked.

    `links` are the valid links in order, `head` is the last of them. `wrong` says in sentences
    where the chain or a signature is broken; `notes` has other sentences about the seal.
    """

    opening: Opening | None = None
    links: list[Link] = field(default_factory=list)
    is_copy: bool = False
    """Whether a repair made the file as a copy of a sealed one: nothing in it is signed."""

    state: SealState = SealState.NONE
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def head(self) -> Link | None:
        """The newest valid link."""
        return self.links[-1] if self.links else None

    def knows(self, digest: str) -> bool:
        """Return whether a valid link has this digest, in hex."""
        return any(link.digest.hex() == digest for link in self.links)


def check_seal(file: InputFile, data: WholeData, state: FileState, loose: int) -> SealOfRead:
    """Check the seal of a file that was read; its last `loose` bytes are no part of it.

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
        ValueError: One is malformed, or there are two openings.
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
    """Compute the chain, and compare each link; stop at the first that is wrong."""
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
