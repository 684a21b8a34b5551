"""The lock of a robot, which lets only one daemon own the robot."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robotctl.base.errors import IN_PARENTHESES, AlreadyRunning
from robotctl.base.paths import make_private
from robotctl.ipc.client import command_for

PID_S = 1.0
"""Limit on the time from the lock to the owner's pid in the file."""


@contextmanager
def owned(path: Path, robot: str) -> Iterator[None]:
    """Own the robot's lock within the block.

    Raises:
        AlreadyRunning: Another daemon owns the lock.
    """
    make_private(path.parent)
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        until = time.monotonic() + PID_S
        while not _locked(fd):
            pid = _living_owner(fd)
            if pid or time.monotonic() > until:
                raise AlreadyRunning(
                    f"robot {robot!r} is running already, pid {pid or 'unknown'}",
                    f"stop it with: {command_for(robot, 'stop')}",
                    sentence=IN_PARENTHESES,
                )
            time.sleep(0.01)
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
        yield
        os.ftruncate(fd, 0)
    finally:
        os.close(fd)


def is_owned(path: Path) -> bool:
    """Return whether a daemon owns the lock, True if another user's file cannot be opened."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except PermissionError:
        return True
    except OSError:
        return False
    try:
        return not _locked(fd)
    finally:
        os.close(fd)


def _locked(fd: int) -> bool:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _living_owner(fd: int) -> int:
    """Return the pid of the lock's owner, 0 if unknown or ended."""
    try:
        pid = int(os.pread(fd, 20, 0))
        os.kill(pid, 0)
    except (ValueError, ProcessLookupError):
        return 0
    except PermissionError:  # the process runs, under another uid
        pass
    return pid
