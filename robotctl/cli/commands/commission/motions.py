"""The motions of a commissioning, each one of the kernel and under a lease."""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from robotctl.cli.support.background import Background
from robotctl.cli.support.held_lease import HeldLease
from robotctl.cli.support.interrupted_drive import (
    CLOSING_SIGNALS,
    stop_drive,
    wait_while_stdout_open,
)
from robotctl.cli.support.quick_actions import asked_by, lease_of_shell
from robotctl.cli.support.signals import interrupted_by
from robotctl.errors import Refused, RobotctlError
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import (
    DRIVE_VELOCITY,
    RECORD_COMMIT,
    RECORD_SPLIT,
    RESET,
    SET_MODE,
)
from robotctl.kernel.modes import Mode

COMMAND = "commission"

DRIVEN_S = 2.0
"""How long the velocity is commanded, in each motion."""

TURN_RPS = 0.3
"""The rate of the turn, unless limits.angular_rps is lower."""

QUIET_S = 2.0
"""How long nothing is commanded in the second one."""

STANDING_S = 1.5
"""Pause before and after each motion, in which the robot stands."""

_LATEST_S = DRIVEN_S + 10.0
"""The end of the first motion if no stop ends it."""

_SPLIT_DEADLINE_S = 15.0


def way_m(speed_mps: float) -> float:
    """Return how much room the straight motions need [m], with half of it in reserve."""
    return 1.5 * speed_mps * (2.0 * DRIVEN_S + QUIET_S)


def turn_rad(rate_rps: float) -> float:
    """Return how far the robot may turn, with half of it in reserve."""
    return 1.5 * rate_rps * DRIVEN_S


def drive_motions(robot: str, speed_mps: float, rate_rps: float) -> Path:
    """Drive forward, and stop by zero; then by silence; turn to the left, and stop by zero.

    Return the file that holds it.

    Raises:
        Interrupted: Ctrl-C or a signal ended it; the robot stands.
        RobotctlError: A motion was refused, or ended by a fault.
    """
    with ExitStack() as stack:
        stack.enter_context(interrupted_by(CLOSING_SIGNALS))
        lease = lease_of_shell()
        if not lease:
            lease = {"lease": stack.enter_context(HeldLease(robot, COMMAND)).token}
        begun = call(robot, RECORD_SPLIT, deadline_s=_SPLIT_DEADLINE_S)["file"]
        common = {**asked_by(COMMAND), **lease, "wait": True}
        straight = common | {"linear_mps": speed_mps, "angular_rps": 0.0}
        turn = common | {"linear_mps": 0.0, "angular_rps": rate_rps}
        time.sleep(STANDING_S)
        _stop_by_zero(robot, straight, "stopping distance")
        time.sleep(STANDING_S)
        silence = {"for_s": DRIVEN_S, "quiet_s": QUIET_S}
        driving = _begin(robot, straight | silence | {"reason": "command timeout of the base"})
        _wait(robot, driving)
        driving.result()
        time.sleep(STANDING_S)
        _stop_by_zero(robot, turn, "stopping angle")
        time.sleep(STANDING_S)
        committed = call(robot, RECORD_COMMIT)
    if committed["failure"] or committed["uncommitted"] or committed["file"] != begun:
        problem = committed["failure"] or "the recording continued in another file"
        raise Refused(f"the motions cannot be measured: {problem}", "try again")
    return Path(begun)


def _stop_by_zero(robot: str, params: dict[str, Any], reason: str) -> None:
    """Drive, then let the kernel command zero at once by ERROR, and clear that again."""
    driving = _begin(robot, params | {"for_s": _LATEST_S, "reason": reason})
    _wait(robot, driving, DRIVEN_S)
    if driving.is_done:
        driving.result()
    stop = asked_by(COMMAND, reason)
    call(robot, SET_MODE, {"mode": Mode.ERROR.value, **stop})
    time.sleep(STANDING_S)
    call(robot, RESET, stop)


def _begin(robot: str, params: dict[str, Any]) -> Background[DriveAnswer]:
    driving: Background[DriveAnswer] = Background(
        partial(call, robot, DRIVE_VELOCITY, params, deadline_s=None)
    )
    driving.start()
    return driving


def _wait(robot: str, driving: Background[DriveAnswer], at_most_s: float | None = None) -> None:
    """Wait for the end of a motion, or for a time; end it where this command is interrupted."""
    try:
        wait_while_stdout_open(driving, at_most_s) if at_most_s else wait_while_stdout_open(driving)
    except KeyboardInterrupt:
        error: RobotctlError = stop_drive(robot, driving)
        raise error from None
