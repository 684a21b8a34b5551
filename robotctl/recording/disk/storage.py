"""The file of a recording: positioned writes, truncation, and sync to the disk."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from fcntl import LOCK_EX, LOCK_NB, LOCK_SH, LOCK_UN, flock
from pathlib import Path
from typing import Protocol

from robotctl.base.errors import Refused
from robotctl.recording.disk.access import open_private

Buffer = bytes | bytearray | memoryview

MAX_PARTS = 1024
"""`pwritev` accepts at most IOV_MAX parts at once (limits.h of Linux)."""

_LOCK_TRIES = 50
_LOCK_WAIT_S = 0.002


class Storage(Protocol):
    """The file operations that a writer needs. Every method may raise OSError."""

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all of `parts`, concatenated, at `offset` [bytes]."""

    def truncate(self, size: int) -> None:
        """Cut the file to `size` bytes."""

    def sync(self) -> None:
        """Make all that was written so far, and the file's name, survive a power cut."""

    def close(self) -> None:
        """Close the file."""


def is_being_written(path: Path) -> bool:
    """Return whether a running process has `path` open as a DiskFile.

    Raises:
        OSError: The file cannot be opened.
    """
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        return is_locked(fd)
    finally:
        os.close(fd)


def is_locked(fd: int) -> bool:
    """Return whether a DiskFile has locked the file that is open as `fd`.

    Raises:
        OSError: The file system has no locks.
    """
    try:
        flock(fd, LOCK_SH | LOCK_NB)
    except BlockingIOError:
        return True
    flock(fd, LOCK_UN)
    return False


def _lock(fd: int) -> None:
    """Lock for writing if possible. Retry for 0.1 s: `is_locked` holds the lock for a moment."""
    for _ in range(_LOCK_TRIES):
        try:
            flock(fd, LOCK_EX | LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOCK_WAIT_S)
        except OSError:
            return  # some network file systems have no locks
        else:
            return


def _sync_folder(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot sync folders
            raise
    finally:
        os.close(fd)


class DiskFile:
    """A file on disk that is locked while it is open; a new file is private to its owner.

    Each `write_at` is one `pwritev` if possible.
    """

    def __init__(self, path: Path, *, new: bool = True) -> None:
        """Create `path`, which must not exist, or open it if not `new`.

        Raises:
            OSError: The file cannot be created or opened.
        """
        flags = os.O_WRONLY | os.O_NOFOLLOW
        if new:
            flags |= os.O_CREAT | os.O_EXCL
        self._fd = open_private(path, flags)
        try:
            _lock(self._fd)
            _sync_folder(path.parent)  # the name must survive a power cut, too
        except BaseException:
            os.close(self._fd)
            if new:
                with suppress(OSError):
                    path.unlink()
            raise

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all of `parts` at `offset`.

        Raises:
            OSError: The disk is full or fails.
        """
        rest = [memoryview(part) for part in parts if len(part)]
        while rest:
            written = os.pwritev(self._fd, rest[:MAX_PARTS], offset)
            if written == 0:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            offset += written
            while rest and written >= rest[0].nbytes:
                written -= rest.pop(0).nbytes
            if written:
                rest[0] = rest[0][written:]

    def truncate(self, size: int) -> None:
        """Cut the file to `size` bytes.

        Raises:
            OSError: The disk fails.
        """
        os.ftruncate(self._fd, size)

    def sync(self) -> None:
        """Force the data to the disk.

        Raises:
            OSError: The disk fails, or the file was removed.
        """
        os.fdatasync(self._fd)
        if os.fstat(self._fd).st_nlink == 0:
            raise OSError(errno.ENOENT, "the file was removed")

    def close(self) -> None:
        """Close the descriptor; closing twice is harmless.

        Raises:
            OSError: The disk fails.
        """
        descriptor, self._fd = self._fd, -1
        if descriptor >= 0:
            os.close(descriptor)


@contextmanager
def new_file(target: Path, open_file: Callable[[Path], Storage] = DiskFile) -> Iterator[Storage]:
    """Yield the new file `target` and close it after the block; remove it if the block raises.

    Raises:
        Refused: `target` exists already, or cannot be written.
    """
    try:
        storage = open_file(target)
    except (OSError, ValueError) as error:
        raise Refused(f"cannot write {target}: {_reason(error)}") from error
    try:
        yield storage
    except BaseException as error:
        with suppress(OSError):
            target.unlink()
        if isinstance(error, OSError):
            raise Refused(f"cannot write {target}: {_reason(error)}") from error
        raise
    finally:
        with suppress(OSError):  # it is synced, or it is gone
            storage.close()


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
