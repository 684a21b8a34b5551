"""Who may read a recording: its owner, or the group as well; never other users.

The umask has no effect. Files made from a recording (its list, clips, repaired and recovered files)
are shared with the group if the recording is.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

_OWNER_READS = {False: 0o600, True: 0o700}
_GROUP_READS = {False: 0o640, True: 0o750}
"""Access modes, by whether the path is a folder."""


def open_private(path: Path, flags: int) -> int:
    """Open a file. With O_CREAT in `flags`, a new file is accessible to its owner only.

    Raises:
        OSError: The file cannot be opened.
    """
    descriptor = os.open(path, flags | os.O_CLOEXEC, _OWNER_READS[False])
    if flags & os.O_CREAT:
        with suppress(OSError):  # a file system without permissions
            os.fchmod(descriptor, _OWNER_READS[False])
    return descriptor


def make_folder(path: Path, *, shared: bool) -> None:
    """Create a folder that must not exist, and its missing parents.

    Raises:
        OSError: The folder exists, or cannot be created.
    """
    missing = [folder for folder in path.parents if not folder.exists()]
    for folder in (*reversed(missing), path):
        folder.mkdir(_OWNER_READS[True], exist_ok=folder != path)
        _set(folder, (_GROUP_READS if shared else _OWNER_READS)[True])


def protect_like(path: Path, source: Path) -> None:
    """Let the owner read `path`, the group only if it may read `source`, and no other users.

    Raises:
        OSError: `path` or `source` does not exist.
    """
    _set(path, (_GROUP_READS if is_shared(source) else _OWNER_READS)[path.is_dir()])


def share_with_group(path: Path) -> None:
    """Make a file or folder of this user readable for its group.

    Raises:
        OSError: There is no such file.
    """
    _set(path, _GROUP_READS[path.is_dir()])


def share_like(path: Path, source: Path) -> None:
    """Make `path` readable for its group if the group may read `source`, its origin.

    Raises:
        OSError: `path` or `source` does not exist.
    """
    if is_shared(source):
        share_with_group(path)


def is_shared(path: Path) -> bool:
    """Return whether the group may read `path` and other users may not.

    Raises:
        OSError: There is no such file.
    """
    return path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH) == stat.S_IRGRP


def _set(path: Path, mode: int) -> None:
    before = path.stat().st_mode
    if stat.S_ISDIR(before):
        mode |= before & stat.S_ISGID  # new files in the folder inherit its group
    if stat.S_IMODE(before) != mode:
        with suppress(OSError):  # a file system without permissions
            path.chmod(mode)


_CURES: Final[Mapping[int, str]] = {
    errno.ENOSPC: "free disk space",
    errno.EDQUOT: "free disk space, or ask for a higher quota",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f)",
    errno.EIO: "check the disk and its cable (sudo dmesg)",
    errno.EROFS: "mount the disk writable, and check why it is not (sudo dmesg)",
    errno.EACCES: "give this user the right to write there",
    errno.EPERM: "give this user the right to write there",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "raise the limit of open files of this machine (sysctl fs.file-max)",
    errno.ENOENT: "check that the disk is mounted and the folder is not removed",
    errno.ESTALE: "check that the disk is mounted",
    errno.ENODEV: "check that the disk is mounted",
    errno.ENXIO: "check that the disk is mounted",
    errno.ENOMEM: "free memory",
}


def size_of(path: Path) -> int:
    """Return the size of a file [bytes], 0 if it cannot be read."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def reason_of(error: BaseException) -> str:
    """Return what caused the error, as a phrase for an error text."""
    return (error.strerror if isinstance(error, OSError) else None) or repr(error)


def cure_of(error: BaseException) -> str:
    """Return what a user can do about the error, as a phrase for an error text."""
    if isinstance(error, MemoryError):
        return _CURES[errno.ENOMEM]
    if isinstance(error, OSError) and error.errno is not None:
        return _CURES.get(error.errno, "check the disk and the folder")
    return "see robotctl logs"
