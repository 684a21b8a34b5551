"""Starts a daemon in the background and waits until it says that it is ready."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotctl.cli.process import readable_within, watched
from robotctl.errors import AlreadyRunning, RobotctlError, UsageError, error_for_exit_code
from robotctl.ipc.client import command_for
from robotctl.paths import log_path, make_private

DAEMON = (sys.executable, "-P", "-m", "robotctl.daemon")
"""-P: what lies in the working directory is not imported in place of a library."""

READY_DEADLINE_S = 60.0
"""From process start to READY: 2 s on a PC; a loaded single-board computer is given its time."""

END_DEADLINE_S = 10.0
"""For a daemon that did not become ready to leave by itself."""

MAX_READY_BYTES = 65536

INTERRUPTIONS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What may end a command from outside, and must not leave half a daemon behind."""

_TOO_SLOW = {"error": f"the daemon was not ready within {READY_DEADLINE_S:g} s"}


@dataclass(frozen=True, slots=True)
class StartOptions:
    """What `robotctl start` passes on to the daemon; None leaves the choice to it."""

    robot: str
    config: Path | None = None
    recordings: Path | None = None
    drive: str | None = None
    sim: bool | None = None
    domain_id: int | None = None
    observe: bool = False
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def command(self) -> list[str]:
        """The daemon's command line."""
        command = [*DAEMON, "--robot", self.robot]
        for name in ("config", "recordings", "drive", "domain_id"):
            value = getattr(self, name)
            if value is not None:
                command += [f"--{name.replace('_', '-')}", str(value)]
        if self.sim is not None:
            command.append("--sim" if self.sim else "--no-sim")
        if self.observe:
            command.append("--observe")
        command += [f"--include={pattern}" for pattern in self.include]
        command += [f"--exclude={pattern}" for pattern in self.exclude]
        return command


def launch(options: StartOptions) -> dict[str, Any]:
    """Start a daemon in a session of its own and return what it says when it is ready.

    Raises:
        RobotctlError: The daemon's reason not to start, with its exit code.
    """
    log = _log_of(options.robot)
    # Under a name of its own until it is clear that no other daemon writes to the robot's log.
    own_log = log.with_name(f"{log.name}.{os.getpid()}")
    # Between the child's birth and the try, a Ctrl-C would leave it behind.
    unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTIONS)
    try:
        pid, ready = _spawn(options.command(), own_log)
    except BaseException:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        raise
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        said = _read_ready(ready)
        failure = None if said.get("ready") is True else _failure(options.robot, pid, said, own_log)
    except BaseException:  # Ctrl-C among them: nothing is left running half-started
        _end(pid, patiently=False)
        own_log.unlink(missing_ok=True)
        raise
    finally:
        os.close(ready)
    if isinstance(failure, AlreadyRunning):
        own_log.unlink()
        raise failure
    with suppress(FileNotFoundError):
        log.replace(log.with_name(f"{log.name}.1"))
    own_log.replace(log)
    if failure is not None:
        raise failure
    return said


def _log_of(robot: str) -> Path:
    """The daemon's log, in a folder that is there."""
    try:
        log = log_path(robot)
        make_private(log.parent)
    except (OSError, RuntimeError) as error:  # a home that cannot be written, or no home at all
        why = f"{error.strerror}: {error.filename}" if isinstance(error, OSError) else error
        raise UsageError(
            f"there is no folder for the log: {why} (set XDG_STATE_HOME to one of yours)"
        ) from error
    return log


def _spawn(command: list[str], log: Path) -> tuple[int, int]:
    """Start the command detached; returns its pid and the end of the pipe to read READY from."""
    reading, writing = os.pipe()
    os.set_inheritable(writing, True)
    try:
        pid = os.posix_spawn(
            command[0],
            [*command, "--ready-fd", str(writing)],
            os.environ,
            file_actions=[
                (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
                (os.POSIX_SPAWN_OPEN, 1, log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600),
                (os.POSIX_SPAWN_DUP2, 1, 2),
            ],
            setsid=True,
            setsigmask=[],
            setsigdef=[signal.SIGPIPE],
        )
    except BaseException:
        os.close(reading)
        raise
    finally:
        os.close(writing)
    return pid, reading


def _read_ready(ready: int) -> dict[str, Any]:
    """The one line of JSON that the daemon writes; {} when it closed the pipe without one."""
    line = b""
    until = time.monotonic() + READY_DEADLINE_S
    while not line.endswith(b"\n"):
        if not readable_within(ready, until - time.monotonic()):
            return _TOO_SLOW
        data = os.read(ready, MAX_READY_BYTES)
        if not data or len(line) > MAX_READY_BYTES:
            break
        line += data
    try:
        said = json.loads(line)
    except ValueError:
        return {}
    return said if isinstance(said, dict) else {}


def _failure(robot: str, pid: int, said: dict[str, Any], log: Path) -> RobotctlError:
    """Why the daemon did not start: in its own words, or else the last ones in its log."""
    ended = _end(pid, patiently=said != _TOO_SLOW)
    if "error" in said:
        exit_code = said.get("exit_code", RobotctlError.exit_code)
        return error_for_exit_code(exit_code, str(said["error"]))
    see = command_for(robot, "logs")
    lines = log.read_text(errors="replace").split("\n") if log.exists() else []
    last = next((line.strip() for line in reversed(lines) if line.strip()), "it wrote nothing")
    return RobotctlError(f"the daemon {ended} before it was ready: {last} (see: {see})")


def _end(pid: int, *, patiently: bool) -> str:
    """Reap our child, by force where it does not leave; returns how it ended."""
    with watched(pid) as process:
        for number in (*[0] * patiently, signal.SIGTERM, signal.SIGKILL):
            os.kill(pid, number)
            if process is not None and readable_within(process, END_DEADLINE_S):
                break
    exit_code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if exit_code < 0:
        return f"was ended by {signal.Signals(-exit_code).name}"
    return f"ended with exit code {exit_code}"
