"""Files that fail like disks do, and damage to MCAP files as it happens in practice."""

from __future__ import annotations

import errno
import os
import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from mcap.opcode import Opcode

from robotctl.recording.format.disk import Buffer, DiskFile
from robotctl.recording.format.records import MAGIC, RECORD_HEAD

PAGE = 4096
"""The largest unit that a disk writes atomically [bytes]."""


class FailingFile(DiskFile):
    """A file whose disk is full from write number `fail_at` (counted from 1) on.

    A write that needs new space then fails after it has written `torn_bytes` of its data.
    """

    def __init__(
        self, path: Path, fail_at: int, *, code: int = errno.ENOSPC, torn_bytes: int = 100
    ) -> None:
        """Create `path`."""
        super().__init__(path)
        self._writes_left = fail_at - 1
        self._code = code
        self._torn_bytes = torn_bytes
        self._held = bytearray()
        """A 1 for each byte that has been written."""

    def fail_now(self) -> None:
        """Make the next write and all later writes fail."""
        self._writes_left = 0

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all parts. If the disk is full, write only `torn_bytes` and raise OSError."""
        data = b"".join(bytes(part) for part in parts)
        end = offset + len(data)
        takes_room = end > len(self._held) or 0 in self._held[offset:end]
        fails = self._writes_left <= 0 and takes_room
        if fails:
            data = data[: self._torn_bytes]
        self._writes_left -= 1
        super().write_at([data], offset)
        end = offset + len(data)
        self._held.extend(bytes(max(end - len(self._held), 0)))
        self._held[offset:end] = b"\1" * len(data)
        if fails:
            raise OSError(self._code, os.strerror(self._code))


class GatedFile(DiskFile):
    """A file on disk that calls the function `wait` before each write, to delay the writer."""

    def __init__(self, path: Path, wait: Callable[[], object]) -> None:
        """Create `path`."""
        super().__init__(path)
        self._wait = wait

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Call the function `wait` given at creation, then write the data to the file."""
        self._wait()
        super().write_at(parts, offset)


class VolatileFile(DiskFile):
    """A file on a disk with a cache, whose unsynced data a power cut may lose."""

    def __init__(self, path: Path) -> None:
        """Create `path`."""
        super().__init__(path)
        self.synced = b""
        """The content at the last sync."""

        self._cached = bytearray()
        self._dirty: set[int] = set()

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write into the cache and into the real file."""
        data = b"".join(bytes(part) for part in parts)
        super().write_at([data], offset)
        end = offset + len(data)
        self._cached.extend(bytes(max(end - len(self._cached), 0)))
        self._cached[offset:end] = data
        self._dirty.update(range(offset // PAGE, -(-end // PAGE)))

    def sync(self) -> None:
        """Make the present content survive a power cut."""
        self.synced = bytes(self._cached)
        self._dirty.clear()

    def after_power_cut(self, dice: random.Random) -> bytes:
        """Return a possible content of the file after a power cut now.

        Each page that was written since the last sync is old, new or torn. The size is between the
        sizes at the last sync and now.
        """
        size = dice.choice(
            [len(self.synced), len(self._cached), dice.randint(len(self.synced), len(self._cached))]
        )
        content = bytearray(self.synced[:size].ljust(size, b"\0"))
        for page in self._dirty:
            start, end = page * PAGE, min((page + 1) * PAGE, size)
            kept = dice.choice([0, PAGE, dice.randrange(0, PAGE, 512)])
            stop = min(start + kept, end)
            if stop > start:
                content[start:stop] = self._cached[start:stop]
        return bytes(content)


def record_boundaries(data: bytes) -> Iterator[int]:
    """Yield the offset of each record of a valid MCAP file, and of its closing magic bytes."""
    offset = len(MAGIC)
    while offset <= len(data) - len(MAGIC):
        yield offset
        if offset == len(data) - len(MAGIC):
            return
        _, length = RECORD_HEAD.unpack_from(data, offset)
        offset += RECORD_HEAD.size + length


def mutated(data: bytes, dice: random.Random) -> bytes:
    """Return `data` with one to three random defects."""
    damaged = bytearray(data)
    for _ in range(dice.randint(1, 3)):
        at = dice.randrange(len(damaged)) if damaged else 0
        size = dice.choice([1, 8, 64, 4096])
        kind = dice.randrange(6)
        if kind == 0 and damaged:
            damaged[at] ^= 1 << dice.randrange(8)
        elif kind == 1:
            damaged[at : at + 8] = dice.choice([2**63, 2**64 - 1, 2**31, 0, 7]).to_bytes(
                8, "little"
            )
        elif kind == 2:
            del damaged[at:]
        elif kind == 3:
            del damaged[at : at + size]
        elif kind == 4:
            damaged[at : at + size] = dice.randbytes(size)
        else:
            damaged[at:at] = damaged[at : at + size]
    return bytes(damaged)


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    """Return the start and end offset of each chunk record in a valid MCAP file."""
    found = []
    for offset in record_boundaries(data):
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        if opcode == Opcode.CHUNK:
            found.append((offset, offset + RECORD_HEAD.size + length))
        elif opcode == Opcode.FOOTER:
            break
    return found


def zero(path: Path, start: int, end: int) -> None:
    """Overwrite a file with zeros from `start` to `end`, as if a power cut had lost these bytes."""
    with path.open("r+b") as stream:
        stream.seek(start)
        stream.write(bytes(end - start))
