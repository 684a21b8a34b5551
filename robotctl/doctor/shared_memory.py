"""Shared memory of Fast DDS that dead processes left behind.

A process holds a lock on `NAME_el` while it uses the memory `NAME`; Linux releases it when the
process ends, so a lock that is free proves that the owner is dead. Memory that another process
still has mapped is left all the same: it may wait for messages there.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from robotctl.doctor.finding import Finding, fault, ok, warning

SHARED_MEMORY: Final = Path("/dev/shm")

SETTLED_S: Final = 10.0
"""Younger files are left alone: their process may not have locked them yet."""

SCARCE_BYTES: Final = 16 << 20
"""A participant of Fast DDS takes 0.6 MB, and one that sends images more."""

_LOCKED = re.compile(r"fastrtps_(?:[0-9a-f]{16}|port\d+)_el")


def check_memory(folder: Path = SHARED_MEMORY) -> Iterator[Finding]:
    """Tell how much shared memory is free, and what dead processes occupy."""
    check = "shared memory"
    try:
        found = os.statvfs(folder)
    except OSError as error:
        yield fault(check, f"{folder}: {error.strerror}", f"mount a tmpfs at {folder}")
        return
    free, size = found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize
    told = f"{free / 1e6:.0f} of {size / 1e6:.0f} MB free in {folder}"
    if not os.access(folder, os.W_OK | os.X_OK):
        yield fault(check, f"you may not write in {folder}", f"sudo chmod 1777 {folder}")
    elif free < SCARCE_BYTES:
        cure = "clean it (robotctl doctor --clean), or give a container more: --shm-size 256m"
        yield fault(check, f"{told}: processes of ROS may not hear each other", cure)
    else:
        yield ok(check, told)
    left = stale(folder)
    if left:
        size = sum(path.stat().st_size for path in left if path.exists())
        yield warning(
            "dead processes",
            f"{len(left)} files in {folder} ({size / 1e6:.1f} MB) belong to no process any more",
            "remove them: robotctl doctor --clean",
        )


def stale(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Return the files of this user whose process is certainly dead."""
    try:
        names = [entry.name for entry in os.scandir(folder) if _LOCKED.fullmatch(entry.name)]
    except OSError:
        return []
    mapped = _mapped(folder)
    found: list[Path] = []
    for name in sorted(names):
        memory = name.removesuffix("_el")
        if memory not in mapped and name not in mapped and _is_free(folder / name):
            belonging = (memory, f"sem.{memory}_mutex", name)
            found += [folder / each for each in belonging if (folder / each).exists()]
    return found


def clean(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Remove the stale files that are found now, and return them."""
    removed = []
    for path in stale(folder):
        with suppress(FileNotFoundError):
            path.unlink()
            removed.append(path)
    return removed


def _is_free(path: Path) -> bool:
    """Return whether the lock file is ours, old, and not locked."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        facts = os.fstat(descriptor)
        if facts.st_uid != os.getuid() or time.time() - facts.st_ctime < SETTLED_S:
            return False
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked
        return False
    finally:
        os.close(descriptor)
    return True


def _mapped(folder: Path) -> set[str]:
    """Return the files of the folder that a process has open or mapped, as far as it shows them."""
    found: set[str] = set()
    for process in Path("/proc").iterdir():
        if not process.name.isdecimal():
            continue
        with suppress(OSError):  # it has ended, or is of another user
            found |= _names_below(folder, (process / "maps").read_text(errors="replace").split())
            links = [os.readlink(each) for each in (process / "fd").iterdir()]
            found |= _names_below(folder, links)
    return found


def _names_below(folder: Path, words: Iterable[str]) -> set[str]:
    start = f"{folder}/"
    return {word.removeprefix(start) for word in words if word.startswith(start)}
