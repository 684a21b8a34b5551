"""lease take: hold the lease while a command runs, or until Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from typing import Annotated

import typer

from robotctl.cli.commands.lease.group import group
from robotctl.cli.options import Reason, Robot
from robotctl.cli.support.held_lease import HeldLease
from robotctl.cli.support.interrupted_drive import CLOSING_SIGNALS, POLL_S
from robotctl.cli.support.quick_actions import checked_reason
from robotctl.cli.support.signals import ignoring, interrupted_by
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
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
    and other clients are refused. The lease ends with this process, or a second after it is frozen
    (Ctrl-Z), and the robot ramps down.

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
    """Run a command that acts for the holder of the lease, and return its exit code."""
    with ignoring((signal.SIGINT,)):  # the terminal sends Ctrl-C to the command, too
        try:
            done = subprocess.run(command, env={**os.environ, LEASE_VARIABLE: token}, check=False)
        except OSError as error:
            raise UsageError(f"{command[0]}: {error.strerror}") from None
    return done.returncode if done.returncode >= 0 else SIGNALLED - done.returncode
