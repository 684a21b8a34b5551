"""A drive that is waited for ends with its command: by Ctrl-C, a signal, or when nobody reads."""

from __future__ import annotations

import select
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final

from robotctl.cli.support.background import Background
from robotctl.cli.support.control import source
from robotctl.cli.support.signals import ignoring
from robotctl.errors import Interrupted, RobotctlError
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call, command_for
from robotctl.ipc.method_names import END_DRIVE, SET_MODE
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

LOST: Final = (signal.SIGHUP, signal.SIGTERM)
"""A terminal that is gone, a session that ends."""

LOOK_S: Final = 0.05
"""How often the end of the drive is looked for."""

NUMBERS_S: Final = 2.0
"""How long the numbers of a drive may take after its end."""

_STDOUT: Final = 1


def wait_while_read(driving: Background[DriveAnswer]) -> None:
    """Wait for the end of the drive; raises KeyboardInterrupt if nobody reads our stdout any more.

    An ssh without a terminal ends so: no signal comes, only its end of our stdout is closed.
    """
    poll = select.poll()
    poll.register(_STDOUT, 0)
    while not driving.is_done:  # a join that is interrupted takes the thread for ended
        if any(found & (select.POLLERR | select.POLLHUP) for _, found in poll.poll(LOOK_S * 1000)):
            raise KeyboardInterrupt


def stopped(robot: str, driving: Background[DriveAnswer]) -> Interrupted:
    """Ramp the robot down, at a second Ctrl-C stop it at once; returns what came of it.

    A terminal that closes sends several signals: only Ctrl-C asks for more. Raises RobotctlError
    where the robot could not be stopped this way.
    """
    try:
        with ignoring(LOST):
            _say("stopping the robot (Ctrl-C again: emergency stop)")
            params = {"source": source("drive")}
            message = call(robot, END_DRIVE, params, deadline_s=None)["message"]
    except KeyboardInterrupt:
        with ignoring((signal.SIGINT, *LOST)):
            message = _emergency_stop(robot)
    return Interrupted(message, answer=_numbers(driving))


def _emergency_stop(robot: str) -> str:
    params = {"source": source("drive"), "mode": EMERGENCY_STOP_MODE}
    message = call(robot, SET_MODE, params)["message"]
    return f"{message} (release it with: {command_for(robot, 'reset')})"


def _numbers(driving: Background[DriveAnswer]) -> Mapping[str, Any]:
    """What is known of the drive after its end; {} where the daemon does not tell."""
    until = time.monotonic() + NUMBERS_S
    while not driving.is_done:
        if time.monotonic() > until:
            return {}
        time.sleep(LOOK_S)
    try:
        return driving.result()
    except RobotctlError as error:
        return error.answer


def _say(text: str) -> None:
    with suppress(OSError):  # the terminal may be gone
        print(f"robotctl: {text}", file=sys.stderr, flush=True)
