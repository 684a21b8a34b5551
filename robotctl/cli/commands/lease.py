"""lease: the sole right to start and steer motion."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT, LEASE_VARIABLE
from robotctl.cli.options import Json, Reason, Robot, new_app, new_group
from robotctl.cli.targets.driving import (
    CLOSING_SIGNALS,
    POLL_S,
    HeldLease,
    ignoring,
    interrupted_by,
)
from robotctl.cli.targets.requests import checked_reason, own_token, request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable
from robotctl.ipc.answers import LeaseStatus
from robotctl.ipc.client import call
from robotctl.ipc.method_names import LEASE_RELEASE, LEASE_STATUS

app = new_app()
group = new_group(app, "lease")


@group.callback()
def lease() -> None:
    """Take the sole right to start and steer motion; anybody may still stop.

    \b
    Examples:
      robotctl lease take -- bash
      robotctl lease status
      robotctl lease release
    """


@group.command()
def release(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Release the lease of this shell; if the robot is moving, it ramps down.

    It works where ROBOTCTL_LEASE holds the token, as in the command that `lease take` runs.

    \b
    Examples:
      robotctl lease release
    """
    token = own_token()
    params = {"source": request_source("lease release")} | ({"token": token} if token else {})
    answer = call(robot, LEASE_RELEASE, params)
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


@group.command()
def status(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show who holds the lease.

    \b
    Examples:
      robotctl lease status --json
    """
    token = own_token()
    answer = call(robot, LEASE_STATUS, {"token": token} if token else {})
    print_answer(dict(answer), [_line(answer)], as_json=as_json)


def _line(answer: LeaseStatus) -> str:
    if answer["holder"] is None:
        return "the lease is free: any client may start a motion"
    why = f" ({answer['reason']})" if answer["reason"] else ""
    you = "; you act for it" if answer["yours"] else ""
    return f"{printable(answer['holder'])} holds the lease{printable(why)}{you}"


SIGNALLED = 128
"""The exit code after a signal, less the signal's number."""


@group.command()
def take(
    command: Annotated[
        list[str] | None,
        typer.Argument(metavar="[-- COMMAND...]", help="What to run while the lease is held."),
    ] = None,
    reason: Reason = "",
    robot: Robot = DEFAULT_ROBOT,
) -> None:
    """Hold the lease while COMMAND runs, or until Ctrl-C.

    Only COMMAND, or a client with the printed ROBOTCTL_LEASE, can start motion; requests over ROS
    and of other clients are refused. The lease ends with this process, or a second after it is
    frozen (Ctrl-Z), and the robot ramps down.

    \b
    Examples:
      robotctl lease take -- bash
      robotctl lease take --reason inspection -- robotctl drive square --wait
    """
    held = HeldLease(robot, "lease take", checked_reason(reason))
    with interrupted_by(CLOSING_SIGNALS):
        with held:
            if command:
                exit_code = _run(command, held.token)
                if held.is_over:
                    held.result()
                sys.exit(exit_code)
            token = f"export {LEASE_VARIABLE}={held.token}"
            with suppress(KeyboardInterrupt):
                print(f"Lease taken. In another shell: {token}", flush=True)
                while not held.is_over:
                    time.sleep(POLL_S)
        print(printable(held.result()["message"]))


def _run(command: list[str], token: str) -> int:
    """Run a command with the token of the lease, and return its exit code."""
    with ignoring((signal.SIGINT,)):  # the terminal sends Ctrl-C to the command, too
        try:
            done = subprocess.run(command, env={**os.environ, LEASE_VARIABLE: token}, check=False)
        except OSError as error:
            raise UsageError(f"{command[0]}: {error.strerror}") from None
    return done.returncode if done.returncode >= 0 else SIGNALLED - done.returncode
