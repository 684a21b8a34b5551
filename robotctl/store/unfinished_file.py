"""A file that gets its name when it is complete, on file systems with and without hard links."""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, Final

from robotctl.regular_file import open_folder

PREFIX: Final = ".unfinished-"

_NOT_OFFERED: Final = (errno.EPERM, errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOSYS)
"""What FAT and exFAT, as of a USB stick, and some network file systems answer."""

_AT_FDCWD: Final = -100
_RENAME_NOREPLACE: Final = 1
"""Of renameat2(2), which os.rename does not know."""


class UnfinishedFile:
    """A file to write, and then to name."""

    def __init__(self, file: IO[bytes], path: Path | None) -> None:
        """Take a file that is open; `path` is its hidden name, None if it has none."""
        self._file = file
        self._path = path
        self.modified_ns = 0
        """Its time of change when it gets its name; 0 leaves it as it is."""

    def write(self, data: bytes) -> None:
        """Append to it.

        Raises:
            OSError: The disk is full or fails.
        """
        self._file.write(data)

    def name_if_free(self, target: Path) -> None:
        """Let it appear as `target`, and return when that would survive a power cut.

        Raises:
            FileExistsError: There is something of that name.
            OSError: The disk is full or fails.
        """
        self._sync()
        if self._path is None:
            self._link(target)
        else:
            _rename_if_free(self._path, target)
        _sync_folder(target.parent)

    def name_over(self, target: Path) -> None:
        """Let it take the place of `target`, and return when that would survive a power cut.

        Raises:
            OSError: The disk is full or fails.
        """
        self._sync()
        path = self._path
        if path is None:
            path = target.with_name(f"{PREFIX}{os.getpid()}-{self._file.fileno()}")
            self._link(path)
        os.replace(path, target)
        _sync_folder(target.parent)

    def _sync(self) -> None:
        self._file.flush()
        if self.modified_ns:
            os.utime(self._file.fileno(), ns=(self.modified_ns, self.modified_ns))
        os.fsync(self._file.fileno())

    def _link(self, target: Path) -> None:
        # A descriptor makes Python follow the link in /proc.
        with open_folder(target.parent) as folder:
            os.link(f"/proc/self/fd/{self._file.fileno()}", target, src_dir_fd=folder)


@contextmanager
def unfinished_file(folder: Path) -> Iterator[UnfinishedFile]:
    """Yield a file in `folder` that is gone after the block unless it got a name.

    A process that is killed leaves nothing; where every file has a name, a hidden one.

    Raises:
        OSError: It cannot be created.
    """
    try:
        descriptor = os.open(folder, os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC, 0o600)
    except OSError as error:
        if error.errno not in _NOT_OFFERED:
            raise
    else:
        with os.fdopen(descriptor, "wb") as file:
            yield UnfinishedFile(file, None)
        return
    named = NamedTemporaryFile(dir=folder, prefix=PREFIX, delete=False)  # noqa: SIM115
    try:
        with named:
            yield UnfinishedFile(named, Path(named.name))
    finally:
        with suppress(FileNotFoundError):  # it has another name by now
            os.unlink(named.name)


def _rename_if_free(path: Path, target: Path) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    source, name = os.fsencode(path), os.fsencode(target)
    if library.renameat2(_AT_FDCWD, source, _AT_FDCWD, name, _RENAME_NOREPLACE):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(target))


def _sync_folder(folder: Path) -> None:
    with open_folder(folder) as descriptor, suppress(OSError):  # some network file systems cannot
        os.fsync(descriptor)
