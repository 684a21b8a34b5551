"""Starts other processes of robotctl; standard library only.

    python -P -m robotctl.MODULE ARGUMENTS --report-fd 3

The child sends reports, one JSON object per line, through a separate pipe.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

_FIRST_FREE_FD: Final = 10
"""The lowest number for our ends of the pipes, above all descriptors that the child gets."""


def open_pipe() -> tuple[int, int]:
    """Return the read and write ends of a pipe, which no child inherits by itself."""
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
    """Write the whole line, also if signals interrupt it."""
    while line:
        line = line[os.write(descriptor, line) :]


@contextmanager
def pidfd_of(pid: int) -> Iterator[int | None]:
    """Yield a descriptor that becomes readable when the process ends; None if it cannot be opened.

    Enter the block before you end the process; after its end, its pid may be reused.
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
"""Sends a report of a job; raises BrokenPipeError if nobody reads it."""


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
    """Return the report that a child sent as `line`, a JSON object.

    Raises:
        ValueError: The line is not a JSON object.
    """
    report = json.loads(line)
    if not isinstance(report, dict):
        raise ValueError(f"not a JSON object: {line[:80]!r}")
    return report


_PIECE_BYTES: Final = 1 << 16
_REAP_POLL_S: Final = 0.01


class Child:
    """A process that `start` has started.

    Use it from one thread. Another thread may call `kill`, except during `close`.
    """

    def __init__(self, pid: int, reports: int, stdin: int | None) -> None:
        self.pid = pid
        self._reports = reports
        self._stdin = stdin
        self._lines = LineSplitter()
        self._exit_code: int | None = None

    def fileno(self) -> int:
        """Return the descriptor of the child's reports, which is also readable after its end."""
        return self._reports

    @property
    def has_stdin(self) -> bool:
        """Whether the child's stdin is an open pipe."""
        return self._stdin is not None

    def send(self, line: bytes) -> None:
        """Write a line to the child's stdin, if `has_stdin`.

        Raises:
            BrokenPipeError: The child has closed its stdin.
        """
        if self._stdin is not None:
            write_whole(self._stdin, line)

    def close_stdin(self) -> None:
        """Close the child's stdin, which asks the child to end."""
        if self._stdin is not None:
            os.close(self._stdin)
            self._stdin = None

    def receive(self, seconds: float | None = None) -> list[dict[str, Any]]:
        """Wait for data, and return the complete reports, possibly none.

        Raises:
            TimeoutError: No data arrived within `seconds`.
            EOFError: The child has closed the pipe.
            ValueError: A line is not a JSON object.
        """
        if seconds is not None and not readable_within(self._reports, seconds):
            raise TimeoutError
        piece = os.read(self._reports, _PIECE_BYTES)
        if not piece:
            raise EOFError
        return [decoded(line) for line in self._lines.feed(piece)]

    def receive_one(self, seconds: float) -> dict[str, Any]:
        """Return the first report that arrives, without others that arrive together with it.

        Raises:
            TimeoutError: No report arrived within `seconds`.
            EOFError: The child has closed the pipe.
            ValueError: The line is not a JSON object.
        """
        until = time.monotonic() + seconds
        while not (report := self.receive(until - time.monotonic())):
            pass
        return report[0]

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send the child a signal, unless its exit code is already known."""
        if self._exit_code is None:
            os.kill(self.pid, number)

    def wait(self, seconds: float) -> int | None:
        """Return the exit code, -N after signal N, or None if the child runs after `seconds`."""
        until = time.monotonic() + seconds
        while self._exit_code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._exit_code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > until:
                return None
            else:
                time.sleep(_REAP_POLL_S)
        return self._exit_code

    def detach(self) -> None:
        """Close the pipes; the process continues."""
        self.close_stdin()
        os.close(self._reports)

    def close(self, patience_s: float = 0.0) -> int:
        """Close the pipes, kill a child that lives after `patience_s`, and return its exit code."""
        self.detach()
        exit_code = self.wait(patience_s)
        while exit_code is None:
            self.kill()
            exit_code = self.wait(patience_s + 1.0)
        return exit_code


# A pipe of its own: libraries print on stdout (Fast DDS warns about lock files).
CHILD_FD: Final = 3
"""The number of the pipe in the child, the first after stdin, stdout and stderr."""


def program(module: str) -> tuple[str, ...]:
    """Return the command that runs a module with this Python."""
    return (sys.executable, "-P", "-m", module)  # -P: no imports from the working directory


def start(
    command: Sequence[str],
    *,
    option: str = REPORT_OPTION,
    with_stdin: bool = False,
    log: Path | None = None,
) -> Child:
    """Start `command` with two more arguments, `option` and the number of the report descriptor.

    With a `log`, the child writes stdout and stderr to that file, has a new session, outlives this
    process and inherits no other descriptors. Without, both go to our stderr, and a Ctrl-C in the
    terminal does not reach the child. Its stdin is /dev/null unless `with_stdin` is set.
    """
    ours: list[int] = []
    theirs: list[int] = []
    if log is not None:
        _stop_inheritance()
    try:
        reports, reporting = open_pipe()
        ours.append(reports)
        theirs.append(reporting)
        our_stdin = None
        if with_stdin:
            their_stdin, our_stdin = open_pipe()
            ours.append(our_stdin)
            theirs.append(their_stdin)
            stdin_action: tuple[Any, ...] = (os.POSIX_SPAWN_DUP2, their_stdin, 0)
        else:
            stdin_action = (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)
        pid = os.posix_spawn(
            command[0],
            [*command, option, str(CHILD_FD)],
            os.environ,
            file_actions=[
                stdin_action,
                _output(log),
                (os.POSIX_SPAWN_DUP2, 1, 2),
                (os.POSIX_SPAWN_DUP2, reporting, CHILD_FD),
            ],
            **({"setpgroup": 0} if log is None else {"setsid": True}),
            setsigmask=[],
            setsigdef=[signal.SIGPIPE],
        )
        ours.clear()
    finally:
        for descriptor in (*theirs, *ours):
            os.close(descriptor)
    return Child(pid, reports, our_stdin)


def _stop_inheritance() -> None:
    """Mark inherited descriptors as close-on-exec."""
    with suppress(OSError):  # no /proc
        for descriptor in map(int, os.listdir("/proc/self/fd")):
            if descriptor > 2:
                with suppress(OSError):  # closed meanwhile, like the descriptor of the listing
                    os.set_inheritable(descriptor, False)


def _output(log: Path | None) -> tuple[Any, ...]:
    if log is not None:
        return (os.POSIX_SPAWN_OPEN, 1, log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    try:
        os.fstat(2)
    except OSError:  # closed
        return (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)
    return (os.POSIX_SPAWN_DUP2, 2, 1)
