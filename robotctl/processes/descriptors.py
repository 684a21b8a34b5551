"""Pipes between processes, and waiting until a file descriptor can be read."""

from __future__ import annotations

import errno
import fcntl
import os
import select
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_FIRST_FREE_FD: Final = 10
"""The lowest number for our ends of the pipes. It is above the descriptors of the child, so that
nothing overwrites our ends, even in a process that was started without stdin, stdout and stderr."""


def open_pipe() -> tuple[int, int]:
    """Return the read and write ends of a pipe that other children do not inherit."""
    ends = os.pipe()
    try:
        reading = _moved(ends[0])
        try:
            return reading, _moved(ends[1])
        except BaseException:
            os.close(reading)
            raise
    finally:
        for end in ends:
            os.close(end)


def _moved(end: int) -> int:
    try:
        return fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, _FIRST_FREE_FD)
    except OSError as error:
        if error.errno == errno.EINVAL:  # the limit of open files is below _FIRST_FREE_FD
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE)) from None
        raise


def write_whole(descriptor: int, line: bytes) -> None:
    """Write the whole line; a signal may interrupt a write to a pipe."""
    while line:
        line = line[os.write(descriptor, line) :]


@contextmanager
def pidfd_of(pid: int) -> Iterator[int | None]:
    """Open a descriptor that becomes readable when the process ends; None if it cannot be opened.

    Open it before the process is asked to end, because afterwards another process may get its pid.
    """
    try:
        descriptor = os.pidfd_open(pid)
    except OSError:  # it has ended, or is in another pid namespace
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def readable_within(descriptor: int, seconds: float) -> bool:
    """Wait until the descriptor is readable, and return whether it is."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(0, int(seconds * 1000))))
