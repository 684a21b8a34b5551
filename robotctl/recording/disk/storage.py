"""The file under a recording: positioned writes, truncation, and forcing data to the disk."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from fcntl import LOCK_EX, LOCK_NB, LOCK_SH, LOCK_UN, flock
from pathlib import Path
from typing import Protocol

from robotctl.recording.disk.access import open_private

Buffer = bytes | bytearray | memoryview

MAX_PARTS = 1024
"""`pwritev` takes at most IOV_MAX parts at once (limits.h of Linux)."""

_LOCK_TRIES = 50
_LOCK_WAIT_S = 0.002


class Storage(Protocol):
    """What the writer needs of a file; every method may raise OSError."""

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all of `parts`, one behind the other, at `offset` [bytes]."""

    def truncate(self, size: int) -> None:
        """Cut the file to `size` bytes."""

    def sync(self) -> None:
        """Return when everything written so far would survive a power cut; it has a name then."""

    def close(self) -> None:
        """Give the file back to the system."""


def is_being_written(path: Path) -> bool:
    """Whether a living process has `path` open as a DiskFile. Raises OSError."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        return is_locked(fd)
    finally:
        os.close(fd)


def is_locked(fd: int) -> bool:
    """Whether somebody else writes the file that is open as `fd`. Raises OSError."""
    try:
        flock(fd, LOCK_SH | LOCK_NB)
    except BlockingIOError:
        return True
    flock(fd, LOCK_UN)
    return False


def _lock(fd: int) -> None:
    """Lock for writing. Somebody who looks whether it is locked is in the way for a moment only."""
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
        if error.errno != errno.EINVAL:  # some network file systems cannot
            raise
    finally:
        os.close(fd)


class DiskFile:
    """A new file on disk, private to its owner, locked while it is open.

    The kernel gets each `write_at` as one `pwritev` where it can.
    """

    def __init__(self, path: Path, *, new: bool = True) -> None:
        """Create `path`, which must not exist, or open it if not `new`. Raises OSError."""
        flags = os.O_WRONLY | os.O_NOFOLLOW
        if new:
            flags |= os.O_CREAT | os.O_EXCL
        self._fd = open_private(path, flags)
        try:
            _lock(self._fd)
            _sync_folder(path.parent)  # the name itself must survive a power cut, too
        except BaseException:
            os.close(self._fd)
            if new:
                with suppress(OSError):
                    path.unlink()
            raise

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all of `parts` at `offset`. Raises OSError."""
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
        """Cut the file to `size` bytes. Raises OSError."""
        os.ftruncate(self._fd, size)

    def sync(self) -> None:
        """Force the data to the disk. Raises OSError, also where somebody has removed the file."""
        os.fdatasync(self._fd)
        if os.fstat(self._fd).st_nlink == 0:
            raise OSError(errno.ENOENT, "somebody has removed the file")

    def close(self) -> None:
        """Close the descriptor; closing twice is harmless. Raises OSError."""
        descriptor, self._fd = self._fd, -1
        if descriptor >= 0:
            os.close(descriptor)
