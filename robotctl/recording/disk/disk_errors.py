"""What a user can do about an error that ends a recording."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from typing import Final

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


def reason_of(error: BaseException) -> str:
    """Return what went wrong, in words."""
    return (error.strerror if isinstance(error, OSError) else None) or repr(error)


def cure_of(error: BaseException) -> str:
    """Return what to do about the error."""
    if isinstance(error, MemoryError):
        return _CURES[errno.ENOMEM]
    if isinstance(error, OSError) and error.errno is not None:
        return _CURES.get(error.errno, "check the disk and the folder")
    return "see robotctl logs"
