"""Pipes between processes, and the reports on them: JSON objects, one per line."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import select
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

_FIRST_FREE_FD: Final = 10
"""The lowest number for our ends of the pipes. It is above the descriptors of the child, so that
nothing overwrites our ends, even in a process that was started without stdin, stdout and stderr."""


def open_pipe() -> tuple[int, int]:
    """Return the read and write ends of a pipe; a child inherits only the end that it is given."""
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
    """Write the whole line; continue if a signal interrupts the write."""
    while line:
        line = line[os.write(descriptor, line) :]


@contextmanager
def pidfd_of(pid: int) -> Iterator[int | None]:
    """Yield a descriptor that becomes readable when the process ends; None if it cannot be opened.

    Enter the block before you end the process: afterwards, its pid may be another process's.
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
    """Wait for at most `seconds`; return whether the descriptor is readable."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(0, int(seconds * 1000))))


REPORT_OPTION: Final = "--report-fd"

Report = Callable[[dict[str, Any]], None]
"""Sends a report of a job; raises BrokenPipeError if the process that started the job has ended."""


class LineSplitter:
    """Splits a byte stream into lines; an incomplete line waits for the next piece."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[bytes]:
        """Return the lines that this piece completes."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        return whole


def report_fd(arguments: Sequence[str]) -> int:
    """Return a child's descriptor for reports; from now on, an exec closes this descriptor.

    Raises:
        SystemExit: The process was not started by robotctl.
    """
    *_, option, text = ("", "", *arguments)
    if option != REPORT_OPTION or not text.isdecimal():
        raise SystemExit(f"this is started by robotctl, with {REPORT_OPTION}")
    os.set_inheritable(int(text), False)
    return int(text)


def send_report(descriptor: int, report: dict[str, Any]) -> None:
    """Send a report to the process that started this one.

    Raises:
        BrokenPipeError: That process has closed the pipe.
    """
    write_whole(descriptor, f"{json.dumps(report)}\n".encode())


def decoded(line: bytes) -> dict[str, Any]:
    """Return the report in a line.

    Raises:
        ValueError: The line is not a JSON object.
    """
    report = json.loads(line)
    if not isinstance(report, dict):
        raise ValueError(f"not a JSON object: {line[:80]!r}")
    return report
