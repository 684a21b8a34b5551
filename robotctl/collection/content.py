"""What a judgement depends on: the content of a recording, and the robotctl that judges."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, cast

import robotctl
from robotctl.base.errors import UnreadableFile
from robotctl.base.files import open_regular
from robotctl.recording.disk.storage import is_being_written
from robotctl.recording.format.names import MADE_BY
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.read.files import recording_files

if TYPE_CHECKING:
    from io import BufferedReader


class BeingWritten(UnreadableFile):
    """A running process is still writing the recording."""


@dataclass(frozen=True, slots=True)
class Content:
    """The content of a recording at one moment: a SHA-256 over its files' names and contents."""

    digest: str
    _marks: tuple[tuple[int, ...], ...]
    """Size, mtime [ns], ctime [ns] and inode of each file."""

    def check(self, path: Path) -> None:
        """Check that the files have not changed since the content was read.

        Raises:
            OSError: A file does not exist any more or cannot be examined.
            UnreadableFile: A file has changed.
        """
        if tuple(_marks(path)) != self._marks:
            raise UnreadableFile(f"{path.name} was changed while it was read")


def read_content(path: Path) -> Content:
    """Read all files of a recording, and return the hash of its content.

    Raises:
        OSError: A file cannot be read.
        UnreadableFile: The recording has no files.
        BeingWritten: A process is still writing the recording.
    """
    digest = hashlib.sha256()
    for file in recording_files(path):
        with suppress(OSError):  # a file system without locks; errors of opening are raised below
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


@cache
def software_hash() -> str:
    """Return the SHA-256 over all modules of robotctl, its version, Python and the C library."""
    package = Path(robotctl.__file__).parent
    digest = hashlib.sha256(f"{robotctl.__version__}\n{MADE_BY}\n".encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def software_name() -> str:
    """Return the versions of robotctl, Python and the C library as readable text."""
    return f"robotctl {robotctl.__version__} on {MADE_BY}"
