"""The one way to start another process of robotctl; standard library only.

    python -P -m robotctl.MODULE ARGUMENTS --report-fd 3

or, where many imports would be made again, as a copy of this process (`fork`).

The child sends reports, one JSON object per line, through a pipe of its own. It may also receive
lines on its stdin. Reports do not use stdout, because libraries print there (Fast DDS warns about
lock files); stdout and stderr go where a user reads them.
"""

from __future__ import annotations

import fcntl
import gc
import json
import os
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, NoReturn

REPORT_OPTION: Final = "--report-fd"

CHILD_FD: Final = 3
"""The number of the pipe in the child, the first after stdin, stdout and stderr."""

_FIRST_FREE_FD: Final = 10
"""The lowest number for our ends of the pipes. It is above the descriptors of the child, so that
nothing overwrites our ends, even in a process that was started without stdin, stdout and stderr."""

_INTERRUPTIONS: Final = (signal.SIGINT, signal.SIGTERM)
_PIECE_BYTES: Final = 1 << 16
_REAP_POLL_S: Final = 0.01


def program(module: str) -> tuple[str, ...]:
    """Return the command that runs a module with this Python.

    With -P, a file in the working directory is not imported in place of a library.
    """
    return (sys.executable, "-P", "-m", module)


class LineSplitter:
    """A splitter of a byte stream into lines; an incomplete line waits for the next piece."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[bytes]:
        """Return the lines that this piece completes."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        return whole


class Child:
    """A process that `start` has started.

    Use it from one thread. Only `kill` may be called from another thread, but not during `close`.
    """

    def __init__(self, pid: int, reports: int, stdin: int | None) -> None:
        self.pid = pid
        self._reports = reports
        self._stdin = stdin
        self._lines = LineSplitter()
        self._exit_code: int | None = None

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when the child sends a report or ends."""
        return self._reports

    @property
    def has_stdin(self) -> bool:
        """Whether its stdin is a pipe that is still open."""
        return self._stdin is not None

    def send(self, line: bytes) -> None:
        """Write a line to its stdin; after `close_stdin`, drop it.

        Raises:
            BrokenPipeError: The child has closed its stdin.
        """
        if self._stdin is not None:
            _write(self._stdin, line)

    def close_stdin(self) -> None:
        """Close its stdin, which asks the child to end."""
        if self._stdin is not None:
            os.close(self._stdin)
            self._stdin = None

    def receive(self, seconds: float | None = None) -> list[dict[str, Any]]:
        """Return the next reports; empty if the next line is not complete yet.

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
        return [_decoded(line) for line in self._lines.feed(piece)]

    def receive_one(self, seconds: float) -> dict[str, Any]:
        """Return the first report.

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
        """Send it a signal, unless its exit code is already known."""
        if self._exit_code is None:
            os.kill(self.pid, number)

    def wait(self, seconds: float) -> int | None:
        """Wait for its exit code: negative for a signal, None if it is still running."""
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
        """Close the pipes, and let the process continue."""
        self.close_stdin()
        os.close(self._reports)

    def close(self, patience_s: float = 0.0) -> int:
        """Close the pipes, kill the process after `patience_s`, and return its exit code."""
        self.detach()
        exit_code = self.wait(patience_s)
        while exit_code is None:
            self.kill()
            exit_code = self.wait(patience_s + 1.0)
        return exit_code


def start(
    command: Sequence[str],
    *,
    option: str = REPORT_OPTION,
    with_stdin: bool = False,
    log: Path | None = None,
) -> Child:
    """Start `command`; `option` passes it the number of the descriptor for its reports.

    With a `log`, its stdout and stderr go there; it runs in its own session, outlives this process
    and inherits no other descriptors. Without a log, both go to our stderr; it has its own process
    group, so that Ctrl-C in the terminal reaches only this process. Its stdin is a pipe if
    `with_stdin`, else /dev/null.
    """
    ours: list[int] = []
    theirs: list[int] = []
    if log is not None:
        _stop_inheritance()
    try:
        reports, reporting = _pipe()
        ours.append(reports)
        theirs.append(reporting)
        our_stdin = None
        if with_stdin:
            their_stdin, our_stdin = _pipe()
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


def has_one_thread() -> bool:
    """Return whether no other thread runs in this process, so that `fork` may copy it."""
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:  # no /proc, or no descriptor left
        return False


def fork(work: Callable[[int, int], None]) -> Child:
    """Start a copy of this process that ends after `work`; it has nothing to import.

    `work(stdin, reports)` gets two descriptors: one to read our lines from, one for `send_report`.
    The copy has its own process group, as after `start`. Fork a process with one thread only: a
    lock that another thread holds would stay locked in the copy.

    Raises:
        OSError: There is no memory or no descriptor left.
    """
    ours: list[int] = []
    theirs: list[int] = []
    signals = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTIONS)
    try:
        reports, reporting = _pipe()
        ours.append(reports)
        theirs.append(reporting)
        their_stdin, our_stdin = _pipe()
        ours.append(our_stdin)
        theirs.append(their_stdin)
        pid = os.fork()
        if not pid:
            _run_copy(partial(work, their_stdin, reporting), ours, signals)
        ours.clear()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        for descriptor in (*theirs, *ours):
            os.close(descriptor)
    return Child(pid, reports, our_stdin)


def _run_copy(
    work: Callable[[], None], ends: Iterable[int], signals: Iterable[signal.Signals | int]
) -> NoReturn:
    """Do the work of a copy, and end it; `ends` are the parent's ends of its pipes."""
    exit_code = 1
    try:
        os.setpgid(0, 0)
        for number in _INTERRUPTIONS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        for descriptor in ends:
            os.close(descriptor)
        gc.freeze()  # a search through what the parent made would copy its memory
        work()
        exit_code = 0
    except BaseException:  # noqa: BLE001 - nothing may go on behind the fork
        traceback.print_exc()
    finally:
        os._exit(exit_code)


def report_fd(arguments: Sequence[str]) -> int:
    """Return, in a child, the descriptor for reports; call it after any restart of the process.

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
    _write(descriptor, f"{json.dumps(report)}\n".encode())


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


def _stop_inheritance() -> None:
    """Keep inherited descriptors from the child: a lock or pipe of the shell would stay open."""
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


def _pipe() -> tuple[int, int]:
    """Return the read and write ends of a pipe that other children do not inherit."""
    ends = os.pipe()
    try:
        reading = fcntl.fcntl(ends[0], fcntl.F_DUPFD_CLOEXEC, _FIRST_FREE_FD)
        try:
            return reading, fcntl.fcntl(ends[1], fcntl.F_DUPFD_CLOEXEC, _FIRST_FREE_FD)
        except BaseException:
            os.close(reading)
            raise
    finally:
        for end in ends:
            os.close(end)


def _write(descriptor: int, line: bytes) -> None:
    """Write the whole line; a signal may interrupt a write to a pipe."""
    while line:
        line = line[os.write(descriptor, line) :]


def _decoded(line: bytes) -> dict[str, Any]:
    report = json.loads(line)
    if not isinstance(report, dict):
        raise ValueError(f"not a JSON object: {line[:80]!r}")
    return report
