"""Start the process of a view, tell where to connect, and end it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from robotctl.cli.support.signals import interrupted_by
from robotctl.cli.ui.text import json_text, printable
from robotctl.environment import RANGE
from robotctl.errors import Interrupted, NoDaemon, Refused, RobotctlError, error_for_exit_code
from robotctl.ipc.client import call
from robotctl.ipc.method_names import STATUS
from robotctl.paths import log_path
from robotctl.processes import Child, program, start
from robotctl.view.view_job import LiveTarget, ViewJob

VIEW: Final = program("robotctl.view")

READY_S: Final = 30.0
"""How long the process may take to listen; it needs half a second."""

END_S: Final = 10.0
"""How long the process may take to leave the domain."""


def live_target(robot: str) -> LiveTarget:
    """Return the running daemon of a robot, and its domain; use its discovery range from now on.

    Raises:
        NoDaemon: None runs.
    """
    status = call(robot, STATUS)
    os.environ.setdefault(RANGE, status["discovery_range"])
    return LiveTarget(robot, status["pid"], status["namespace"], status["domain_id"])


def check_view_installed() -> None:
    """Check that the extra is there.

    Raises:
        Refused: It is not.
    """
    if find_spec("websockets") is None:
        raise Refused("the view needs the package websockets", "pip install 'robotctl[view]'")


def start_view_of(robot: str) -> dict[str, Any]:
    """Start a view that goes on until the daemon ends, and return its report `ready`.

    Raises:
        RobotctlError: The view cannot be served.
    """
    log = log_path(robot).with_name("view.log")
    log.unlink(missing_ok=True)
    child, ready = start_view(ViewJob(live=live_target(robot), outlives_stdin=True), log)
    child.detach()
    return ready


def start_view(job: ViewJob, log: Path | None = None) -> tuple[Child, dict[str, Any]]:
    """Start the process of a view, and return it with its report `ready`.

    With a `log`, its stderr goes there, and it may outlive this process.

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
    """Serve a view until Ctrl-C or its own end, and print where to connect.

    Raises:
        NoDaemon: The daemon has ended.
        RobotctlError: The view cannot be served.
    """
    with interrupted_by((signal.SIGTERM, signal.SIGHUP)):
        child, ready = start_view(job)
        try:
            lines = ready_lines(job, ready)
            print(json_text(ready) if as_json else "\n".join(lines), flush=True)
            for said in reports_of(child):
                if "ended" in said:
                    raise NoDaemon(said["ended"])
            raise RobotctlError("the process of the view has ended")
        except KeyboardInterrupt:
            raise Interrupted from None
        finally:
            child.close(END_S)


def ready_lines(job: ViewJob, ready: dict[str, Any]) -> Iterator[str]:
    """Yield what a user needs to connect, and what viewers may do."""
    may = "viewers may stop and drive it" if job.lease else "viewers may stop it"
    shown = f"robot {job.live.robot} in Foxglove and Lichtblick"
    yield f"{shown}, {may if job.control else 'read-only'}"
    yield f"  connect to  {ready['url']}"
    yield f"  or open     {ready['open']}"


def reports_of(child: Child, seconds: float | None = None) -> Iterator[dict[str, Any]]:
    """Yield the reports until the process ends; raise the error that one tells."""
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
