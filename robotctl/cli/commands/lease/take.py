"""lease take: hold the lease while a command runs, or until Ctrl-C."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from functools import partial
from typing import Annotated

import typer

from robotctl.cli.commands.lease.group import group
from robotctl.cli.options import Reason, Robot
from robotctl.cli.support.background import Background
from robotctl.cli.support.interrupted_drive import CLOSING_SIGNALS, POLL_S
from robotctl.cli.support.quick_actions import checked_reason, request_source
from robotctl.cli.support.signals import ignoring, interrupted_by
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
from robotctl.ipc.answers import LeaseAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import LEASE_RELEASE, LEASE_STATUS, LEASE_TAKE
from robotctl.paths import DEFAULT_ROBOT, LEASE_VARIABLE

SIGNALLED = 128
"""Added by shells to the number of the signal that ended a command."""


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

    Motion is then started by COMMAND alone, or with the printed ROBOTCTL_LEASE; requests over ROS
    and other clients are refused. The lease ends with this process, and the robot ramps down.

    \b
    Examples:
      robotctl lease take -- bash
      robotctl lease take --reason inspection -- robotctl drive square --wait
    """
    token = secrets.token_hex(16)
    source = request_source("lease take")
    params = {"token": token, "source": source, "reason": checked_reason(reason)}
    with interrupted_by(CLOSING_SIGNALS):
        holding: Background[LeaseAnswer] = Background(
            partial(call, robot, LEASE_TAKE, params, deadline_s=None)
        )
        try:
            holding.start()
            while not holding.is_done and not call(robot, LEASE_STATUS, {"token": token})["yours"]:
                time.sleep(POLL_S)
            if not holding.is_done:
                if command:
                    sys.exit(_run(command, token))
                print(f"Lease taken. In another shell: export {LEASE_VARIABLE}={token}", flush=True)
            while not holding.is_done:
                time.sleep(POLL_S)
        except KeyboardInterrupt:
            pass
        finally:
            if not holding.is_done:
                with ignoring((signal.SIGINT, *CLOSING_SIGNALS)):
                    call(robot, LEASE_RELEASE, {"token": token, "source": source})
        print(printable(holding.result()["message"]))


def _run(command: list[str], token: str) -> int:
    """Run a command that acts for the holder of the lease, and return its exit code."""
    with ignoring((signal.SIGINT,)):  # the terminal sends Ctrl-C to the command, too
        try:
            done = subprocess.run(command, env={**os.environ, LEASE_VARIABLE: token}, check=False)
        except OSError as error:
            raise UsageError(f"{command[0]}: {error.strerror}") from None
    return done.returncode if done.returncode >= 0 else SIGNALLED - done.returncode
