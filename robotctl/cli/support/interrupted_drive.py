"""End a drive together with the command that waits for it.

The command ends by Ctrl-C, by a signal, or when the reader of its output has gone.
"""

from __future__ import annotations

import select
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from math import inf
from typing import Any, Final

from robotctl.cli.support.background import Background
from robotctl.cli.support.quick_actions import request_source
from robotctl.cli.support.signals import ignoring
from robotctl.errors import Interrupted, RobotctlError
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call, command_for
from robotctl.ipc.method_names import END_DRIVE, SET_MODE
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

CLOSING_SIGNALS: Final = (signal.SIGHUP, signal.SIGTERM)
"""The signals of a terminal that closes and of a session that ends."""

POLL_S: Final = 0.05
"""How often the end of the drive is checked."""

REPORT_DEADLINE_S: Final = 2.0
"""How long the daemon may take to report a drive after its end."""

_STDOUT: Final = 1


def wait_while_stdout_open(driving: Background[DriveAnswer], at_most_s: float = inf) -> None:
    """Wait for the end of the drive, or for a time.

    Raises:
        KeyboardInterrupt: The reader of stdout has closed it. This is how an ssh connection
            without a terminal ends: no signal arrives.
    """
    poll = select.poll()
    poll.register(_STDOUT, 0)
    end = time.monotonic() + at_most_s
    while (
        not driving.is_done and time.monotonic() < end
    ):  # an interrupted join would take the thread for ended
        if any(found & (select.POLLERR | select.POLLHUP) for _, found in poll.poll(POLL_S * 1000)):
            raise KeyboardInterrupt


def stop_drive(robot: str, driving: Background[DriveAnswer]) -> Interrupted:
    """Ramp the robot down, or stop it at once at a second Ctrl-C, and return the error to raise.

    A terminal that closes sends several signals, so only Ctrl-C counts as the second one.

    Raises:
        RobotctlError: The robot could not be stopped this way.
    """
    try:
        with ignoring(CLOSING_SIGNALS):
            _say("stopping the robot (Ctrl-C again: emergency stop)")
            params = {"source": request_source("drive")}
            message = call(robot, END_DRIVE, params, deadline_s=None)["message"]
    except KeyboardInterrupt:
        with ignoring((signal.SIGINT, *CLOSING_SIGNALS)):
            message = _emergency_stop(robot)
    return Interrupted(message, answer=_drive_report(driving))


def _emergency_stop(robot: str) -> str:
    params = {"source": request_source("drive"), "mode": EMERGENCY_STOP_MODE}
    message = call(robot, SET_MODE, params)["message"]
    return f"{message} (release it with: {command_for(robot, 'reset')})"


def _drive_report(driving: Background[DriveAnswer]) -> Mapping[str, Any]:
    """Return the numbers of the ended drive, or {} if the daemon does not report them in time."""
    until = time.monotonic() + REPORT_DEADLINE_S
    while not driving.is_done:
        if time.monotonic() > until:
            return {}
        time.sleep(POLL_S)
    try:
        return driving.result()
    except RobotctlError as error:
        return error.answer


def _say(text: str) -> None:
    with suppress(OSError):  # the terminal may be gone
        print(f"robotctl: {text}", file=sys.stderr, flush=True)
