"""Start the process of a daemon or of a view, and wait until it is ready."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, cast

from robotctl.base.environment import RANGE
from robotctl.base.errors import (
    IN_PARENTHESES,
    AlreadyRunning,
    Interrupted,
    NoDaemon,
    Refused,
    RobotctlError,
    UsageError,
    error_for_exit_code,
)
from robotctl.base.paths import lock_path, log_path, make_private
from robotctl.base.processes import Child, program, start
from robotctl.cli.targets.driving import interrupted_by
from robotctl.cli.ui.text import json_text, printable
from robotctl.daemon.lock import is_owned
from robotctl.ipc.answers import StartSummary
from robotctl.ipc.client import call, command_for
from robotctl.ipc.method_names import STATUS
from robotctl.view.view_job import LiveTarget, ViewJob

DAEMON = program("robotctl.daemon")

READY_DEADLINE_S = 60.0
"""The timeout from process start to READY [s]; a PC needs 2 s."""

END_DEADLINE_S = 10.0
"""The timeout of the exit of a daemon that did not become ready [s]."""

INTERRUPTIONS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The signals that end a command."""

_TOO_SLOW = {"error": f"the daemon was not ready within {READY_DEADLINE_S:g} s"}


def daemon_command(robot: str, options: Mapping[str, object], words: Sequence[str]) -> list[str]:
    """Return the command line of a daemon, with `words` at its end.

    An option with the value None or False is left out; True makes a flag. A list repeats the
    option.
    """
    command = [*DAEMON, "--robot", robot]
    for name, value in options.items():
        if value is True:
            command.append(f"--{name}")
        elif value is not None and value is not False:
            values = value if isinstance(value, list) else [value]
            command += [f"--{name}={each}" for each in values]
    return [*command, *words]


def launch(
    robot: str,
    command: Sequence[str],
    on_ready: Callable[[StartSummary], None] = lambda ready: None,
) -> StartSummary:
    """Start a daemon by `command` in a new session, and return its report when it is ready.

    `on_ready` is called with the report. If a signal interrupts this function or `on_ready`, the
    daemon ends.

    Raises:
        RobotctlError: The daemon did not start; the error has its reason and exit code.
    """
    try:
        log = log_path(robot)
        make_private(log.parent)
    except (OSError, RuntimeError) as error:  # a home that cannot be written, or no home at all
        why = f"{error.strerror}: {error.filename}" if isinstance(error, OSError) else error
        raise UsageError(
            f"the folder for the log cannot be created: {why}",
            "set XDG_STATE_HOME to a folder of yours",
            sentence=IN_PARENTHESES,
        ) from error
    # A separate file, until it is clear that no other daemon writes to the robot's log.
    own_log = log.with_name(f"{log.name}.{os.getpid()}")
    # A Ctrl-C between the start of the child and the `try` would leave the child behind.
    unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTIONS)
    try:
        daemon = start(command, option="--ready-fd", log=own_log)
    except BaseException:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        raise
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        try:
            said = daemon.receive_one(READY_DEADLINE_S)
        except TimeoutError:
            said = _TOO_SLOW
        except (EOFError, ValueError):  # it ended without a report, or sent something else
            said = {}
        if said.get("ready") is True:
            _put_in_place(own_log, log)
            summary = cast(StartSummary, said)
            on_ready(summary)
            daemon.detach()
            return summary
        ended = _end(daemon, patiently=said != _TOO_SLOW)
    except BaseException:  # also Ctrl-C: no half-started daemon stays behind
        _end(daemon, patiently=False)
        own_log.unlink(missing_ok=True)
        raise
    is_running = is_owned(lock_path(robot))  # then `log` belongs to the other daemon
    kept = log.with_name(f"{log.name}.failed") if is_running else log
    see = str(kept) if is_running else command_for(robot, "logs")
    failure = _failure(ended, said, own_log, see)
    if isinstance(failure, AlreadyRunning | UsageError):  # own_log has only this error
        own_log.unlink(missing_ok=True)
    elif is_running:
        own_log.replace(kept)
    else:
        _put_in_place(own_log, log)
    raise failure


def _put_in_place(own_log: Path, log: Path) -> None:
    """Rename the robot's previous log, then put `own_log` in its place."""
    with suppress(FileNotFoundError):
        log.replace(log.with_name(f"{log.name}.1"))
    own_log.replace(log)


def _failure(ended: str, said: dict[str, Any], log: Path, see: str) -> RobotctlError:
    """Return the error in the daemon's report `said`, or else one with the last line of its log."""
    if "error" in said:
        exit_code = said.get("exit_code", RobotctlError.exit_code)
        return error_for_exit_code(exit_code, str(said["error"]), said)
    lines = log.read_text(errors="replace").split("\n") if log.exists() else []
    last = next((line.strip() for line in reversed(lines) if line.strip()), "its log is empty")
    return RobotctlError(
        f"the daemon {ended} before it was ready: {last}", f"see: {see}", sentence=IN_PARENTHESES
    )


def _end(daemon: Child, *, patiently: bool) -> str:
    """End the daemon, and return how it ended; if `patiently`, first give it time to exit."""
    if not (patiently and daemon.wait(END_DEADLINE_S) is not None):
        daemon.kill(signal.SIGTERM)
    exit_code = daemon.close(END_DEADLINE_S)
    if exit_code < 0:
        return f"was ended by {signal.Signals(-exit_code).name}"
    return f"ended with exit code {exit_code}"


VIEW: Final = program("robotctl.view")

READY_S: Final = 30.0
"""The timeout for a view to be ready [s]; it needs half a second."""

END_S: Final = 10.0
"""The timeout for a view to leave the ROS domain and exit [s]."""


def live_target(robot: str) -> LiveTarget:
    """Return the process, namespace and ROS domain of a robot's running daemon.

    An unset discovery range in the environment is set to the daemon's.

    Raises:
        NoDaemon: No daemon runs.
    """
    status = call(robot, STATUS)
    os.environ.setdefault(RANGE, status["discovery_range"])
    return LiveTarget(robot, status["pid"], status["namespace"], status["domain_id"])


def check_view_installed() -> None:
    """Check that the extra robotctl[view] is installed.

    Raises:
        Refused: The extra is not installed.
    """
    if find_spec("websockets") is None:
        raise Refused("the view needs the package websockets", "pip install 'robotctl[view]'")


def start_view_of(robot: str) -> dict[str, Any]:
    """Start a live view (Foxglove) of a robot until its daemon ends; return the view's URLs.

    Raises:
        RobotctlError: The view cannot be served.
    """
    log = log_path(robot).with_name("view.log")
    log.unlink(missing_ok=True)
    child, ready = start_view(ViewJob(live=live_target(robot), outlives_stdin=True), log)
    child.detach()
    return ready


def start_view(job: ViewJob, log: Path | None = None) -> tuple[Child, dict[str, Any]]:
    """Start the process of a live view; return the process, and its URLs when it is ready.

    With a `log`, the view writes its stderr to this file, and may outlive this process.

    Raises:
        RobotctlError: The view cannot be served; the process has ended.
    """
    child = start(VIEW, with_stdin=True, log=log)
    try:
        with suppress(BrokenPipeError):  # it has ended; the next line notices
            child.send(f"{job.to_json()}\n".encode())
        for said in reports_of(child, READY_S):
            if "note" in said:
                print(f"robotctl: {printable(said['note'])}", file=sys.stderr)
            if "ready" in said:
                return child, said["ready"]
        raise RobotctlError("the process of the view has ended")
    except BaseException:
        child.close(END_S)
        raise


def show_view(job: ViewJob, *, as_json: bool) -> None:
    """Start a view, print its addresses, and wait until it ends.

    Raises:
        Interrupted: Ctrl-C or a signal ended the view.
        NoDaemon: The daemon has ended.
        RobotctlError: The view cannot be served.
    """
    with interrupted_by((signal.SIGTERM, signal.SIGHUP)):
        child, ready = start_view(job)
        try:
            may = "viewers may stop and drive it" if job.lease else "viewers may stop it"
            shown = f"robot {job.live.robot} in Foxglove and Lichtblick"
            lines = (
                f"{shown}, {may if job.control else 'read-only'}",
                f"  connect to  {ready['url']}",
                f"  or open     {ready['open']}",
            )
            print(json_text(ready) if as_json else "\n".join(lines), flush=True)
            for said in reports_of(child):
                if "ended" in said:
                    raise NoDaemon(said["ended"])
            raise RobotctlError("the process of the view has ended")
        except KeyboardInterrupt:
            raise Interrupted from None
        finally:
            child.close(END_S)


def reports_of(child: Child, seconds: float | None = None) -> Iterator[dict[str, Any]]:
    """Yield the reports of the view process `child` until its end; wait at most `seconds` for each.

    Raises:
        RobotctlError: The process reported an error, or nothing within `seconds`.
    """
    while True:
        try:
            reports = child.receive(seconds)
        except EOFError:
            return
        except TimeoutError:
            raise RobotctlError(f"the view was not ready within {seconds:g} s") from None
        for said in reports:
            if "error" in said:
                raise error_for_exit_code(said["exit_code"], printable(said["error"]), said)
            yield said
