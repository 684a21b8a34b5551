"""The limits of reading by a file's size on the disk, and the errors of reading.

Parts beyond a limit are not read, and are reported together with `CURE`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from math import isfinite
from typing import Final, Self

from robotctl.base.errors import UsageError

VARIABLE: Final = "ROBOTCTL_READ_LIMITS"
"""Environment variable with a factor for all limits here."""

CURE: Final = f"to read it all, set {VARIABLE}=10: ten times the limit"

MAX_FACTOR: Final = 1_000_000.0

UNPACKED_BYTES: Final = 512 << 20
"""Least limit of all unpacked chunks of a file. They take 0.25 s (0.5 s with a copy)."""

UNPACKED_RATIO: Final = 512
"""Limit of all unpacked chunks of a large file, as a multiple of its size."""

FAST_CHUNK_BYTES: Final = 24 << 20
FAST_CHUNK_DISCOUNT: Final = 10
"""A tenth of the size counts for chunks up to FAST_CHUNK_BYTES, which unpack ten times as fast (22
instead of 2 GB/s, measured with zeros). A day of black VGA images stays below the limit. Of black
1080p images, which compress to 1/15600, 5 GiB are read."""

CHUNK_BYTES: Final = 72 << 20
CHUNK_RATIO: Final = 32
"""A chunk may unpack to CHUNK_BYTES, or to CHUNK_RATIO times its stored size if that is more."""

OPEN_BYTES: Final = 96 << 20
OPEN_RATIO: Final = 32
MAX_OPEN_BYTES: Final = 256 << 20
"""Chunks that overlap in time may together unpack to OPEN_BYTES, or to OPEN_RATIO times the file
size if that is more, but at most to MAX_OPEN_BYTES."""

ATTACHMENT_BYTES: Final = 256 << 20
"""A larger attachment is not loaded."""

RECORDS: Final = 100_000
BYTES_PER_RECORD: Final = 4
"""A file may hold RECORDS records, or one for every 4 bytes if that is more. Harmless files have at
most one for every 6 bytes."""

JOURNAL_ENTRIES: Final = 30_000
BYTES_PER_JOURNAL_ENTRY: Final = 16
"""A journal may have JOURNAL_ENTRIES entries, or one for every 16 bytes of file if that is more.
Re-running an entry takes 25 us."""

SNAPSHOTS: Final = 1000
BYTES_PER_SNAPSHOT: Final = 1000
"""A journal may have SNAPSHOTS snapshots, or one for every 1000 bytes of file if that is more. The
kernel starts from one in 1 ms; daemons write one every 10 s."""

JOURNAL_TEXT_BYTES: Final = 16 << 20
JOURNAL_TEXT_RATIO: Final = 16
"""The journal's JSON may have JOURNAL_TEXT_BYTES, or this multiple of the file size if that is
more; JSON of robotctl compresses to 1/10."""

ZSTD_FILE_BYTES: Final = 256 << 20
ZSTD_FILE_RATIO: Final = 64
"""A file compressed as a whole may unpack to ZSTD_FILE_BYTES or this multiple of its size."""


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """The limits for reading one file. `unpacked_cost` bounds the sum of all `unpacking_cost`s."""

    unpacked_cost: int
    chunk_bytes: int
    chunk_ratio: int
    open_bytes: int
    attachment_bytes: int
    records: int
    journal_entries: int
    journal_text_bytes: int
    snapshots: int
    zstd_file_bytes: int

    @classmethod
    def of(cls, stored_bytes: int) -> Self:
        """Return the limits of a file with `stored_bytes` on the disk.

        Raises:
            UsageError: The factor for the limits in the environment is not valid.
        """
        factor = _factor()

        def limit(least: int, share: float) -> int:
            return int(factor * max(least, stored_bytes * share))

        return cls(
            unpacked_cost=limit(UNPACKED_BYTES, UNPACKED_RATIO),
            chunk_bytes=int(factor * CHUNK_BYTES),
            chunk_ratio=int(factor * CHUNK_RATIO),
            open_bytes=min(limit(OPEN_BYTES, OPEN_RATIO), int(factor * MAX_OPEN_BYTES)),
            attachment_bytes=int(factor * ATTACHMENT_BYTES),
            records=limit(RECORDS, 1 / BYTES_PER_RECORD),
            journal_entries=limit(JOURNAL_ENTRIES, 1 / BYTES_PER_JOURNAL_ENTRY),
            journal_text_bytes=limit(JOURNAL_TEXT_BYTES, JOURNAL_TEXT_RATIO),
            snapshots=limit(SNAPSHOTS, 1 / BYTES_PER_SNAPSHOT),
            zstd_file_bytes=limit(ZSTD_FILE_BYTES, ZSTD_FILE_RATIO),
        )


def unpacking_cost(unpacked_bytes: int) -> int:
    """Return how much a chunk of `unpacked_bytes` counts against `ReadLimits.unpacked_cost`."""
    return unpacked_bytes // (FAST_CHUNK_DISCOUNT if unpacked_bytes <= FAST_CHUNK_BYTES else 1)


def _factor() -> float:
    text = os.environ.get(VARIABLE, "").strip()
    if not text:
        return 1.0
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not (isfinite(factor) and 1 <= factor <= MAX_FACTOR):
        raise UsageError(f"{VARIABLE}={text[:40]}", f"give a number from 1 to {MAX_FACTOR:g}")
    return factor


@dataclass(slots=True)
class Tally:
    """A count for each place (offset) in a file, and the sum of all counts."""

    of: dict[int, int] = field(default_factory=dict)
    total: int = 0

    def note(self, place: int, number: int) -> None:
        """Set the count of `place` to `number`, unless its count is already higher."""
        known = self.of.get(place, 0)
        if number > known:
            self.total += number - known
            self.of[place] = number

    def others(self, place: int) -> int:
        """Return the sum of all counts but that of `place`, an offset."""
        return self.total - self.of.get(place, 0)


class UnpackBudget:
    """The number of bytes of chunks that may still be decompressed."""

    def __init__(self, limits: ReadLimits) -> None:
        self._limit = limits.unpacked_cost
        self._left = limits.unpacked_cost

    def spend(self, unpacked_bytes: int) -> None:
        """Count a chunk that unpacks to this size.

        Raises:
            BeyondLimit: The budget is exhausted.
        """
        self._left -= unpacking_cost(unpacked_bytes)
        if self._left < 0:
            raise beyond_unpacking(self._limit)


def beyond_unpacking(limit: int) -> BeyondLimit:
    """Return the error for an unpacked size above `limit` bytes."""
    return BeyondLimit(f"unpacked it would take more than {limit >> 20} MiB")


class Damaged(Exception):
    """A part of a file cannot be read. The text does not name the file."""


class Unreadable(Damaged):
    """The disk or the memory failed. The same part may be readable later."""


class BeyondLimit(Damaged):
    """A file exceeds the limits of `read_limits`. The text says how to raise them."""

    def __init__(self, what: str) -> None:
        """Append to `what` how to raise the limits."""
        super().__init__(f"{what} ({CURE})")


_failures: ContextVar[list[str] | None] = ContextVar("failures", default=None)


@contextmanager
def noted_read_failures() -> Iterator[list[str]]:
    """Yield a list that gets a sentence for each failed read of this thread in the block."""
    found: list[str] = []
    token = _failures.set(found)
    try:
        yield found
    finally:
        _failures.reset(token)


def note_read_failure(sentence: str) -> None:
    """Add `sentence` to the list of the enclosing `noted_read_failures` block, if there is one."""
    if (found := _failures.get()) is not None:
        found.append(sentence)
