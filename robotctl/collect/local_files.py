"""Reads files that are collected: piece by piece, and so that no link leads elsewhere."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Final

from robotctl.errors import UnreadableFile
from robotctl.recording.disk.disk_errors import reason_of

PIECE_BYTES: Final = 1 << 18

Pace = Callable[[int], None]
"""Called before this number of bytes is sent or read back, and with 0 while a file here is read.

It waits as long as a limit demands, or while the robot must not be disturbed.
"""


@dataclass(frozen=True, slots=True)
class FileStamp:
    """What changes when a file is written: cheaper to compare than its hash."""

    size: int
    modified_ns: int
    inode: int


@contextmanager
def open_collected(path: Path) -> Iterator[FileIO]:
    """Open a regular file that is no link for the block.

    Raises:
        UnreadableFile: It is another one, or cannot be read.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
    try:
        with FileIO(os.open(path, flags)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file")
            yield file
    except OSError as error:
        raise UnreadableFile(f"{path.name} cannot be read: {reason_of(error)}") from error


def stamp_of(file: FileIO) -> FileStamp:
    """Return the stamp of an open file."""
    status = os.fstat(file.fileno())
    return FileStamp(status.st_size, status.st_mtime_ns, status.st_ino)


def pieces_of(file: FileIO) -> Iterator[bytes]:
    """Yield the content of an open file."""
    while piece := file.read(PIECE_BYTES):
        yield piece


def hash_of_file(file: FileIO, pace: Pace) -> str:
    """Return the SHA-256 of an open file, which is read at its beginning."""
    digest = hashlib.sha256()
    pace(0)
    for piece in pieces_of(file):
        digest.update(piece)
        pace(0)
    return digest.hexdigest()


def sha256_of(path: Path, pace: Pace) -> str:
    """Return the SHA-256 of a file.

    Raises:
        UnreadableFile: It cannot be read.
    """
    with open_collected(path) as file:
        return hash_of_file(file, pace)
