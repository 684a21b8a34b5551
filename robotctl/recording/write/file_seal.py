"""The seal of the file that is being written: a running hash, and signed links.

A seal that fails never stops the recording: the file continues unsealed, and `failure` says why.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from typing import Final, Protocol

from robotctl.recording.disk.storage import Buffer
from robotctl.recording.format.seal_records import Link, LinkKind, Opening, SealOfFile, chained

LINK_PERIOD_S: Final = 10.0
"""Period of the links in the data [s]; the head in the summary is written with each commit."""


class Sealer(Protocol):
    """Gives each file its key, and stores the newest link. Used in the writer thread only.

    After any error that a method raises, the rest of the file has no seal.
    """

    def open_file(self, file: str) -> SealOfFile:
        """Return the seal of a new file."""

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        """Store `link` outside the recording; the bytes that the link covers are on the disk."""


class FileSeal:
    """The hash chain of one file. It covers every byte of the file, and is signed after `open`."""

    def __init__(self, sealer: Sealer, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin the chain at the beginning of the file; `clock` gives seconds."""
        self._sealer = sealer
        self._clock = clock
        self._hash = sha256()
        self._base = b""
        self._number = 1
        self._seal: SealOfFile | None = None
        self._due = 0.0
        self._stored: Link | None = None
        """The last link of the file if `keep` has not stored it yet."""

        self._head: Link | None = None
        self.failure = ""
        """Why the file is no longer sealed, or ""."""

    def open(self, file: str) -> bytes:
        """Begin to sign; return the opening record for the file, or empty bytes after a failure."""
        try:
            self._seal = self._sealer.open_file(file)
        except Exception as error:  # noqa: BLE001 - the seal never stops a recording
            self._fail(error)
            return b""
        opening = self._seal.opening
        self._base = bytes.fromhex(opening.previous)
        self._due = self._clock()  # soon, so that the next file can continue this one
        return opening.record()

    def cover(self, part: Buffer) -> None:
        """Add the next bytes of the file."""
        self._hash.update(part)

    @property
    def link_is_due(self) -> bool:
        """Whether a link must be added to the data now."""
        return self._seal is not None and self._clock() >= self._due

    def link(self, covered: int) -> bytes:
        """Return the record of a signed link for the bytes before `covered`; empty on failure."""
        link = self._signed(LinkKind.LINK, covered)
        if link is None:
            return b""
        self._stored = link
        self._base = link.digest
        self._hash = sha256()
        self._number += 1
        self._due = self._clock() + LINK_PERIOD_S
        return link.record()

    def head(self, covered: int) -> bytes:
        """Return the record of a signed head for the bytes before `covered`; empty on failure."""
        if self._seal is None:
            return b""
        self._head = self._signed(LinkKind.HEAD, covered)
        return b"" if self._head is None else self._head.record()

    def keep(self, *, closed: bool = False) -> None:
        """Store the last link outside the recording; if the file is `closed`, the head instead.

        Call it when the bytes that the link or head covers are on the disk.
        """
        link = self._head if closed else self._stored
        if self._seal is None or link is None:
            return
        self._stored = None
        try:
            self._sealer.keep(self._seal.opening, link, closed=closed)
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)

    def _signed(self, kind: LinkKind, covered: int) -> Link | None:
        if self._seal is None:
            return None
        digest = chained(self._base, self._hash.digest())
        plain = Link(kind, self._number, covered, time.time_ns(), digest)
        try:
            return replace(plain, signature=self._seal.sign(plain.signed()))
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)
            return None

    def _fail(self, error: Exception) -> None:
        self._seal = None
        self.failure = f"the rest of this file is not sealed: {error}"
