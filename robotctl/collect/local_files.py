"""The files of a recording that are collected, read so that no link leads elsewhere."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Final

from robotctl.errors import UnreadableFile
from robotctl.recording.disk.disk_errors import reason_of
from robotctl.recording.format.derived_files import INDEX_FILE
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.keep.catalog import CatalogFolder

PIECE_BYTES: Final = 1 << 18


@dataclass(frozen=True, slots=True)
class FileStamp:
    """What changes when a file is written: cheaper to compare than its hash."""

    size: int
    modified_ns: int
    inode: int


def collected_paths(recording: CatalogFolder) -> list[Path]:
    """Return the files of a recording to collect: data, clips, list of files, index.

    While it is being made, these are the files of data that are finished.
    """
    folder = recording.path
    data = [file.path for file in (*recording.files, *recording.clips) if not file.live]
    if recording.live:
        return data
    beside = [folder / METADATA_FILE, folder / INDEX_FILE]
    return data + [path for path in beside if path.is_file() and not path.is_symlink()]


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


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        UnreadableFile: It cannot be read.
    """
    with open_collected(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
