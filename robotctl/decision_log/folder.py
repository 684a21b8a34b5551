"""The files of a decision log: numbered, appended to, removed only when they are years old."""

from __future__ import annotations

import errno
import os
import re
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

from robotctl.kernel.units import DAY_S
from robotctl.paths import make_private, robot_state_folder
from robotctl.regular_file import open_folder, open_regular

FILE_BYTES: Final = 1_000_000
"""A file that has grown to this size is followed by the next one."""

MAX_FILE_BYTES: Final = 2 * FILE_BYTES
"""Of a larger file, which robotctl did not write, only this much is read."""

YEAR_S: Final = 365.25 * DAY_S
"""The unit of `decisions.keep_years` in seconds."""

KEPT_FILES: Final = 2
"""The last files, which are never removed."""

_NAME: Final = re.compile(r"decisions-(\d{6})\.jsonl")


def log_folder(robot: str) -> Path:
    """Return the folder of the robot's decision log."""
    return robot_state_folder(robot) / "decisions"


def files_of(folder: Path) -> list[Path]:
    """Return the files of the log in their order; none if there is no such folder."""
    with suppress(OSError):
        return sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name))
    return []


def number_of(path: Path) -> int:
    """Return the number of a file of the log; the first one that a robot writes has 1."""
    match = _NAME.fullmatch(path.name)
    assert match is not None, path
    return int(match[1])


def content_of(path: Path) -> bytes:
    """Return what a file of the log holds.

    Raises:
        OSError: It cannot be read, or is not a regular file.
    """
    with open_regular(path) as file:
        return file.read(MAX_FILE_BYTES)


def open_last(folder: Path) -> int:
    """Open the file to append to, for this user alone, and return its descriptor.

    Raises:
        OSError: It cannot be opened, or it is not a regular file.
        UsageError: Another user could change the folder.
    """
    make_private(folder)
    files = files_of(folder)
    path = files[-1] if files else folder / _name(1)
    if files and path.lstat().st_size >= FILE_BYTES:
        path = _next(path)
    begun = not os.path.lexists(path)
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o600)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # a FIFO that has a reader
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if begun:
        _sync(folder)
    return descriptor


def remove_oldest(folder: Path, keep_s: float, now_s: float) -> Path | None:
    """Remove the oldest file if it was last written more than `keep_s` seconds ago; return it.

    One at a time, and never the last two: a clock that is years ahead must not remove a log.

    Raises:
        OSError: It cannot be removed.
    """
    files = files_of(folder)
    if len(files) <= KEPT_FILES or not keep_s or now_s - files[0].lstat().st_mtime <= keep_s:
        return None
    files[0].unlink()
    return files[0]


def _sync(folder: Path) -> None:
    with open_folder(folder) as descriptor:
        os.fsync(descriptor)


def _name(number: int) -> str:
    return f"decisions-{number:06}.jsonl"


def _next(path: Path) -> Path:
    return path.with_name(_name(number_of(path) + 1))
