"""The one way to start another process of robotctl; standard library only.

    python -P -m robotctl.MODULE ARGUMENTS --say-fd 3

The child says one JSON object a line on a pipe of its own, and obeys lines on its stdin where it is
told to obey. Its stdout is no channel: libraries print there when they like (Fast DDS complains of
lock files), so stdout and stderr go where a user reads them.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

SAY_OPTION: Final = "--say-fd"

CHILD_FD: Final = 3
"""The number of the pipe in the child, the first after stdin, stdout and stderr."""

_FIRST_FREE_FD: Final = 10
"""Our ends lie above the numbers that a child is given: no step of its start overwrites one, not
even in a process that was itself started without stdin, stdout and stderr."""

_PIECE_BYTES: Final = 1 << 16
_REAP_POLL_S: Final = 0.01


def program(module: str) -> tuple[str, ...]:
    """The command that runs a module with this Python.

    -P: a file in the working directory is not imported in place of a library.
    """
    return (sys.executable, "-P", "-m", module)


class Lines:
    """Cuts what comes in pieces into lines; the rest waits for the next piece."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[bytes]:
        """The lines that the piece ends."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        return whole


class Child:
    """A process that was started here. Only `kill` may be called beside another thread's call,
    and not beside `close`."""

    def __init__(self, pid: int, said: int, orders: int | None) -> None:
        self.pid = pid
        self._said = said
        self._orders = orders
        self._lines = Lines()
        self._exit_code: int | None = None

    def fileno(self) -> int:
        """The descriptor that becomes readable when the child says something or ends."""
        return self._said

    @property
    def obeys(self) -> bool:
        """Whether it can still be told something."""
        return self._orders is not None

    def tell(self, line: bytes) -> None:
        """Write a line to its stdin; dropped after `hang_up`. Raises BrokenPipeError."""
        if self._orders is not None:
            _write(self._orders, line)

    def hang_up(self) -> None:
        """End its stdin, which asks it to end."""
        if self._orders is not None:
            os.close(self._orders)
            self._orders = None

    def hear(self, seconds: float | None = None) -> list[dict[str, Any]]:
        """What it says next; empty where that is not yet a whole line.

        Raises:
            TimeoutError: It said nothing within `seconds`.
            EOFError: It says nothing more.
            ValueError: It said something else than JSON objects.
        """
        if seconds is not None and not readable_within(self._said, seconds):
            raise TimeoutError
        piece = os.read(self._said, _PIECE_BYTES)
        if not piece:
            raise EOFError
        return [_decoded(line) for line in self._lines.feed(piece)]

    def hear_one(self, seconds: float) -> dict[str, Any]:
        """The first thing that it says. Raises as `hear` does."""
        until = time.monotonic() + seconds
        while not (said := self.hear(until - time.monotonic())):
            pass
        return said[0]

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send it a signal, unless it has been waited for."""
        if self._exit_code is None:
            os.kill(self.pid, number)

    def wait(self, seconds: float) -> int | None:
        """Its exit code, negative for the signal that ended it; None while it runs on."""
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

    def leave(self) -> None:
        """Close the pipes, and let it run on."""
        self.hang_up()
        os.close(self._said)

    def close(self, patience_s: float = 0.0) -> int:
        """Close the pipes and reap it, by force after `patience_s`; returns its exit code."""
        self.leave()
        exit_code = self.wait(patience_s)
        while exit_code is None:
            self.kill()
            exit_code = self.wait(patience_s + 1.0)
        return exit_code


def start(
    command: Sequence[str],
    *,
    option: str = SAY_OPTION,
    obeys: bool = False,
    log: Path | None = None,
) -> Child:
    """Start `command`, which is told by `option` which descriptor is the pipe to speak on.

    Its stdout and stderr go to `log`, and it then leaves our session, outlives us and inherits no
    descriptor of our caller; without a log both go to our stderr, and it has a process group of its
    own: a Ctrl-C in our terminal is ours to pass on. Its stdin is a pipe where it `obeys`, else
    /dev/null.
    """
    ours: list[int] = []
    theirs: list[int] = []
    if log is not None:
        _keep_descriptors()
    try:
        said, speaking = _pipe()
        ours.append(said)
        theirs.append(speaking)
        orders = None
        if obeys:
            listening, orders = _pipe()
            ours.append(orders)
            theirs.append(listening)
            stdin: tuple[Any, ...] = (os.POSIX_SPAWN_DUP2, listening, 0)
        else:
            stdin = (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)
        pid = os.posix_spawn(
            command[0],
            [*command, option, str(CHILD_FD)],
            os.environ,
            file_actions=[
                stdin,
                _output(log),
                (os.POSIX_SPAWN_DUP2, 1, 2),
                (os.POSIX_SPAWN_DUP2, speaking, CHILD_FD),
            ],
            **({"setpgroup": 0} if log is None else {"setsid": True}),
            setsigmask=[],
            setsigdef=[signal.SIGPIPE],
        )
        ours.clear()
    finally:
        for descriptor in (*theirs, *ours):
            os.close(descriptor)
    return Child(pid, said, orders)


def say_fd(arguments: Sequence[str]) -> int:
    """In a child, the descriptor to speak on; call it after any restart of the process.

    Raises SystemExit where it was started by hand.
    """
    *_, option, text = ("", "", *arguments)
    if option != SAY_OPTION or not text.isdecimal():
        raise SystemExit(f"this is started by robotctl, with {SAY_OPTION}")
    os.set_inheritable(int(text), False)
    return int(text)


def say(descriptor: int, said: dict[str, Any]) -> None:
    """Write a line for the process that started this one. Raises BrokenPipeError."""
    _write(descriptor, f"{json.dumps(said)}\n".encode())


@contextmanager
def watched(pid: int) -> Iterator[int | None]:
    """A descriptor that becomes readable when the process ends; None where it is out of sight.

    Taken before the process is asked to end: afterwards its pid may be another's.
    """
    try:
        descriptor = os.pidfd_open(pid)
    except OSError:  # gone already, or in another pid namespace
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def readable_within(descriptor: int, seconds: float) -> bool:
    """Wait until a descriptor can be read, for at most so long."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(0, int(seconds * 1000))))


def _keep_descriptors() -> None:
    """Let no child inherit what we inherited: a lock or a pipe of the shell would stay open."""
    with suppress(OSError):  # no /proc
        for descriptor in map(int, os.listdir("/proc/self/fd")):
            if descriptor > 2:
                with suppress(OSError):  # closed meanwhile, as the one that listed them
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
    """A pipe whose ends no other child inherits."""
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
    """Write all of it: a signal may cut a write to a pipe short."""
    while line:
        line = line[os.write(descriptor, line) :]


def _decoded(line: bytes) -> dict[str, Any]:
    said = json.loads(line)
    if not isinstance(said, dict):
        raise ValueError(f"not a JSON object: {line[:80]!r}")
    return said
