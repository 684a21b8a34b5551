"""Open files and folders of any origin, but refuse FIFOs and devices. Standard library only."""

from __future__ import annotations

import errno
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading, unless it is a FIFO or a device.

    Raises:
        OSError: The file cannot be opened, or is not a regular file.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "it is not a regular file", str(path))


@contextmanager
def open_folder(folder: Path) -> Iterator[int]:
    """Open a folder for the block, to lock or sync it, and yield its descriptor.

    Raises:
        OSError: `folder` cannot be opened, or is no folder.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Write the entries of a folder to the disk (fsync).

    Raises:
        OSError: `folder` cannot be opened or synced, or is no folder.
    """
    with open_folder(folder) as descriptor:
        os.fsync(descriptor)


ABANDONED_S: Final = 3600.0
"""An unfinished file that is unchanged for this time was left by a killed process."""


def remove_abandoned(folder: Path, pattern: str) -> None:
    """Remove the files matching the glob `pattern` that were unchanged for ABANDONED_S."""
    with suppress(OSError):
        for unfinished in folder.glob(pattern):
            if time.time() - unfinished.lstat().st_mtime > ABANDONED_S:
                unfinished.unlink()
