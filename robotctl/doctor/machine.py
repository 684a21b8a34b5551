"""Disk, clock, access rights and priorities of this computer."""

from __future__ import annotations

import errno
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from robotctl import open_files
from robotctl.doctor.finding import Finding, fault, ok, warning
from robotctl.errors import RobotctlError
from robotctl.paths import chain_to

SCARCE_BYTES: Final = 2_000_000_000
"""The recorder warns when less is free (`warn_free_bytes`)."""

FULL_BYTES: Final = 500_000_000
"""The recorder does not begin when less is free (`stop_free_bytes`)."""

BUILT_S: Final = 1_735_689_600.0
"""2025-01-01: a clock before that was never set."""

AHEAD_S: Final = 60.0
"""A file that is newer than the clock by more was written before the clock was set back."""


def check_disk(folder: Path, *, is_used: bool = False) -> Iterator[Finding]:
    """Tell how much room recordings have in a folder, or in the one where it will be made.

    With `is_used` a daemon records there, maybe of a user who may write where this one may not.
    """
    check = "disk"
    existing = _existing(folder)
    other = "choose another with --recordings"
    if not os.path.isdir(existing):
        yield fault(check, f"{existing} is not a folder, nor a link to one", other)
        return
    found = os.statvfs(existing)
    free = found.f_bavail * found.f_frsize
    told = f"{free / 1e9:.1f} GB free for recordings in {folder}"
    cure = "remove old recordings, or set recording.max_total_gb"
    if not is_used and not os.access(existing, os.W_OK | os.X_OK):
        yield fault(check, f"you may not write in {existing}", other)
    elif free < FULL_BYTES or (found.f_files and not found.f_favail):
        yield fault(check, told if free < FULL_BYTES else f"no inode is left in {existing}", cure)
    elif free < SCARCE_BYTES:
        yield warning(check, told, cure)
    else:
        yield ok(check, told)


def check_clock(now_s: float, state: Path) -> Iterator[Finding]:
    """Tell whether the clock was set, and not set back since something was written in `state`."""
    check = "clock"
    try:
        newest = max((entry.stat().st_mtime for entry in os.scandir(state)), default=0.0)
    except OSError:
        newest = 0.0
    told = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now_s))
    cure = "set it, for example by systemd-timesyncd or chrony, before the daemon starts"
    if now_s < BUILT_S:
        yield fault(check, f"it says {told}: it was never set", cure)
    elif newest > now_s + AHEAD_S:
        late = newest - now_s
        yield warning(check, f"it says {told}, but {state} was written {late:.0f} s later", cure)
    else:
        yield ok(check, told)


def check_folders(*folders: Path) -> Iterator[Finding]:
    """Tell whether sockets, latches and keys have a place, and are safe there from other users."""
    wrong = []
    for folder in folders:
        chain = chain_to(folder).for_client()
        try:
            chain.check()
            _check_place(folder)
        except RobotctlError as error:
            wrong.append(fault("permissions", error.cause, error.cure))
        except OSError as error:
            cure = f"set {chain.variable} to a folder of yours"
            text = f"{folder} cannot be used: {error.filename}: {error.strerror}"
            wrong.append(fault("permissions", text, cure))
        else:
            cure = "take the right of the group away: chmod g-w FOLDER"
            wrong += [warning("permissions", each, cure) for each in chain.group_writable()]
    yield from wrong or [ok("permissions", "only you can change sockets, latches and keys")]


def check_descriptors() -> Iterator[Finding]:
    """Tell whether a daemon may open enough files; one without a free one answers no client."""
    check = "open files"
    _, limit = resource.getrlimit(resource.RLIMIT_NOFILE)  # to which a daemon raises its own
    told = f"a process may open {limit} at a time"
    if limit == resource.RLIM_INFINITY or limit >= open_files.ENOUGH:
        yield ok(check, told)
    elif limit >= open_files.LEAST:
        text = f"{told}: a daemon may need {open_files.ENOUGH}"
        yield warning(check, text, open_files.CURE)
    else:
        text = f"{told}: a daemon needs {open_files.LEAST} to start"
        yield fault(check, text, open_files.CURE)


def check_priority(fifo_priority: int) -> Iterator[Finding]:
    """Tell whether the configured real-time priority is allowed."""
    check = "rtprio"
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    allowed = 99 if limit == resource.RLIM_INFINITY or os.getuid() == 0 else limit
    if fifo_priority > allowed:
        yield warning(
            check,
            f"fifo_priority is {fifo_priority}, and the limit of this user is {allowed}",
            "add to /etc/security/limits.d/: @realtime - rtprio 99, and log in again",
        )
    elif fifo_priority:
        yield ok(check, f"fifo_priority {fifo_priority} is allowed")
    else:
        yield ok(check, f"not asked for (fifo_priority); up to {allowed} is allowed")


def _check_place(folder: Path) -> None:
    """Check that the folder exists or can be created, on a disk that can be written.

    Whether we may write in a folder that exists does not matter: it may be that of another user's
    daemon, whose client we are.

    Raises:
        OSError: It cannot.
    """
    existing = _existing(folder)
    if not os.path.isdir(existing):
        raise OSError(errno.ENOTDIR, "is not a folder, nor a link to one", str(existing))
    if os.statvfs(existing).f_flag & os.ST_RDONLY:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(existing))
    if existing != folder and not os.access(existing, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "you may not write there", str(existing))


def _existing(path: Path) -> Path:
    """Return the path, or the nearest one above it that exists; a link to nothing exists."""
    return next(each for each in (path, *path.parents) if os.path.lexists(each))
