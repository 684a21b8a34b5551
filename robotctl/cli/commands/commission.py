"""commission: measure a base by three short motions, and propose limits and gains for it."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from math import degrees, inf
from pathlib import Path
from typing import Annotated, Any

import typer

from robotctl.base.errors import Refused, RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.targets.driving import (
    CLOSING_SIGNALS,
    Background,
    HeldLease,
    interrupted_by,
    stop_drive,
    wait_while_stdout_open,
)
from robotctl.cli.targets.requests import asked_by, lease_of_shell
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable, short_path
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import (
    DRIVE_VELOCITY,
    PARAM_LIST,
    PREFLIGHT,
    RECORD_COMMIT,
    RECORD_SPLIT,
    RESET,
    SET_MODE,
)
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams

COMMAND = "commission"

DRIVEN_S = 2.0
"""The duration of the velocity in each motion [s]."""

TURN_RPS = 0.3
"""The rate of the turn [rad/s], unless limits.angular_rps is lower."""

QUIET_S = 2.0
"""The time without a command at the end of the second motion [s]."""

STANDING_S = 1.5
"""The time at rest before and after each motion [s]."""

RESERVE = 1.5
"""The free room in the question to the operator, as a multiple of planned distance and angle."""

_LATEST_S = DRIVEN_S + 10.0
"""The limit on a motion that waits for a zero command [s]."""

_SPLIT_DEADLINE_S = 15.0


def drive_motions(robot: str, speed_mps: float, rate_rps: float) -> Path:
    """Drive forward twice and turn left once; return the file with the recorded motions.

    Raises:
        Interrupted: Ctrl-C or a signal ended the motions; the robot stands.
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
        _drive(robot, straight | silence | {"reason": "command timeout of the base"})
        time.sleep(STANDING_S)
        _stop_by_zero(robot, turn, "stopping angle")
        time.sleep(STANDING_S)
        committed = call(robot, RECORD_COMMIT)
    if committed["failure"] or committed["uncommitted"] or committed["file"] != begun:
        problem = committed["failure"] or "the recording continued in another file"
        raise Refused(f"the motions cannot be measured: {problem}", "try again")
    return Path(begun)


def _stop_by_zero(robot: str, params: dict[str, Any], reason: str) -> None:
    """Drive for DRIVEN_S, stop by a request for ERROR, then reset."""
    _drive(robot, params | {"for_s": _LATEST_S, "reason": reason}, DRIVEN_S)
    stop = asked_by(COMMAND, reason)
    call(robot, SET_MODE, {"mode": Mode.ERROR.value, **stop})
    time.sleep(STANDING_S)
    call(robot, RESET, stop)


def _drive(robot: str, params: dict[str, Any], at_most_s: float = inf) -> None:
    """Begin a motion, and wait until it ends, at most `at_most_s`.

    Raises:
        Interrupted: Ctrl-C ended the motion.
        RobotctlError: The motion was refused, or ended by a fault.
    """
    driving: Background[DriveAnswer] = Background(
        partial(call, robot, DRIVE_VELOCITY, params, deadline_s=None)
    )
    try:
        driving.start()  # inside the `try`: an interrupt may come after the request was sent
        wait_while_stdout_open(driving, at_most_s)
    except KeyboardInterrupt:
        error: RobotctlError = stop_drive(robot, driving)
        raise error from None
    if driving.is_done:
        driving.result()


app = new_app()

MIN_SPEED_MPS, MAX_SPEED_MPS = 0.02, 0.3


@app.command()
def commission(
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the proposed configuration to this new file."),
    ] = None,
    speed: Annotated[float, typer.Option(metavar="M/S", help="Speed of the motions.")] = 0.1,
    yes: Annotated[bool, typer.Option("--yes", help="The room is free: do not ask.")] = False,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Measure the base by three short motions, and propose limits and gains.

    Straight ahead, twice: one motion is stopped by a zero command, and after the other nothing is
    commanded, to see when the base stops by itself. Then a slow turn on the spot. The report has
    rate and delay of odometry, the delay of a command, stopping distance and angle, and the base's
    own command timeout.

    Ctrl-C stops the robot. Other clients cannot move it meanwhile; anybody can stop it.

    \b
    Examples:
      robotctl commission
      robotctl commission --out robot.yaml
      robotctl commission --yes --json
    """
    if not MIN_SPEED_MPS <= speed <= MAX_SPEED_MPS:
        raise UsageError(f"--speed {speed:g}", f"use {MIN_SPEED_MPS:g} to {MAX_SPEED_MPS:g} m/s")
    if out is not None and os.path.lexists(out):
        raise UsageError(f"{out} exists already", "choose another name")
    if out is not None and not os.access(out.parent, os.W_OK):
        raise UsageError(f"{out.parent} cannot be written to", "choose another folder")
    for condition in call(robot, PREFLIGHT)["conditions"]:  # before the question
        if condition["problem"]:
            raise Refused(condition["problem"], condition["cure"])
    settings = {
        each["key"]: each["value"]
        for each in call(robot, PARAM_LIST)["parameters"]
        if each["value"] != each["default"]
    }
    present = _present(settings)
    rate_rps = min(TURN_RPS, present.limits.angular_rps)
    if not yes:
        _confirm(speed, rate_rps)
    file = drive_motions(robot, speed, rate_rps)
    answer, lines, problem = _report(robot, file, settings, present, out)
    print_answer(answer, lines, as_json=as_json, error=problem)


def _present(settings: Mapping[str, Any]) -> KernelParams:
    from robotctl.config import Config, with_setting

    config = Config()
    for key, value in settings.items():
        config = with_setting(config, key, value)
    return config.kernel


def _confirm(speed_mps: float, rate_rps: float) -> None:
    if sys.stdin is None or not sys.stdin.isatty():
        raise UsageError("the robot would move, and there is no terminal to ask on", "give --yes")
    way_m = RESERVE * speed_mps * (2.0 * DRIVEN_S + QUIET_S)
    turn_rad = RESERVE * rate_rps * DRIVEN_S
    question = (
        f"The robot drives up to {way_m:.1f} m straight ahead at {speed_mps:g} m/s,\n"
        f"then it turns up to {degrees(turn_rad):.0f} degrees to the left on its place.\n"
        "Is the way free, and your hand on its emergency stop?"
    )
    if not typer.confirm(question, err=True):
        raise Refused("the robot was not moved")


def _report(
    robot: str, file: Path, settings: Mapping[str, Any], present: KernelParams, out: Path | None
) -> tuple[dict[str, object], Iterator[str], UsageError | None]:
    """Measure and return the report; write the proposed configuration to `out`, if given."""
    from robotctl.commission import (
        file_lines,
        measured,
        measured_lines,
        proposals,
        read_trial,
        warnings,
    )

    base = measured(read_trial(file))
    proposed = proposals(base, present)
    problem = None
    if out is not None:
        problem = _write(out, "\n".join(file_lines(robot, base, settings, proposed)) + "\n")
    written = out if problem is None else None

    def lines() -> Iterator[str]:
        yield f"measured from {short_path(file)}"
        yield from (f"  {line}" for line in measured_lines(base))
        yield "proposed"
        yield from (f"  {each.key}: {each.value:g}  # {each.why}" for each in proposed)
        yield from (f"warning: {printable(text)}" for text in warnings(base))
        if written is not None:
            yield f"written to {short_path(written)}: robotctl start --config {short_path(written)}"

    answer: dict[str, object] = {
        "recording": str(file),
        "measured": asdict(base),
        "proposed": {each.key: each.value for each in proposed},
        "warnings": list(warnings(base)),
        "configuration": None if written is None else str(written),
    }
    return answer, lines(), problem


def _write(out: Path, text: str) -> UsageError | None:
    """Write a new file completely or not at all; return the error, or None."""
    created = False
    try:
        with out.open("x", encoding="utf-8") as file:
            created = True
            file.write(text)
    except OSError as error:
        if created:
            out.unlink(missing_ok=True)
        return UsageError(f"{out}: {error.strerror}", "choose another file")
    return None
