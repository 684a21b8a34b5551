"""What a check reads of a recording: its files and `metadata.yaml`, by hash and by their marks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from robotctl.errors import UnreadableFile
from robotctl.recording.disk.storage import is_being_written
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.read.files import recording_files
from robotctl.regular_file import open_regular

if TYPE_CHECKING:
    from io import BufferedReader


class BeingWritten(UnreadableFile):
    """A recording to which a running process still adds."""


@dataclass(frozen=True, slots=True)
class Content:
    """The content of a recording at one moment.

    `digest` is the SHA-256 over names and contents.
    """

    digest: str
    _marks: tuple[tuple[int, ...], ...]
    """Size, times of change [ns] and inode of each file on a disk."""

    def check(self, path: Path) -> None:
        """Raise what was wrong with reading the recording since then, if anything was.

        Raises:
            OSError: A file is gone or cannot be examined.
            UnreadableFile: A file has changed.
        """
        if tuple(_marks(path)) != self._marks:
            raise UnreadableFile(f"{path.name} was changed while it was read")


def read_content(path: Path) -> Content:
    """Return the content of a recording.

    Raises:
        OSError: A file cannot be read.
        UnreadableFile: There are no files.
        BeingWritten: A process still writes it.
    """
    digest = hashlib.sha256()
    for file in recording_files(path):
        with suppress(OSError):  # no locks there; what cannot be opened is told below
            if is_being_written(file):
                raise BeingWritten(f"{path.name} is being written")
    marks = tuple(_marks(path))
    for file in _files(path):
        with open_regular(file) as opened:
            content = hashlib.file_digest(cast("BufferedReader", opened), "sha256").hexdigest()
        digest.update(f"{file.name}\n{content}\n".encode())
    return Content(digest.hexdigest(), marks)


def _files(path: Path) -> Iterator[Path]:
    yield from recording_files(path)
    metadata = (path if path.is_dir() else path.parent) / METADATA_FILE
    if metadata.is_file():
        yield metadata


def _marks(path: Path) -> Iterator[tuple[int, ...]]:
    for file in _files(path):
        status = file.stat()
        yield status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino
