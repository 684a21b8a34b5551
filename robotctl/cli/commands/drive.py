"""drive: pick a pattern and its size, and start moving."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from typing import Annotated, Any

import typer

from robotctl.cli.commands.watch import polled_until, show
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support.answer import tell
from robotctl.cli.support.background import Background
from robotctl.cli.support.control import source
from robotctl.cli.support.interrupted_drive import LOST, stopped, wait_while_read
from robotctl.cli.support.signals import interrupted_by
from robotctl.cli.terminal.text import is_terminal, number, printable
from robotctl.errors import RobotctlError, UsageError
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import DRIVE
from robotctl.kernel.drive import MAX_LAPS
from robotctl.kernel.patterns import MAX_SIZE_M, MAX_SPEED_MPS, MIN_SIZE_M, MIN_SPEED_MPS
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


class Pattern(StrEnum):
    """What the robot can drive by itself."""

    SQUARE = "square"
    CIRCLE = "circle"
    FIGURE_EIGHT = "figure-eight"


@app.command()
def drive(
    pattern: Annotated[
        Pattern, typer.Argument(metavar="PATTERN", help="square, circle or figure-eight.")
    ],
    side: Annotated[
        float | None, typer.Option(metavar="M", help="Side of the square, in metres.")
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(metavar="M", help="Radius of the circle or of each loop, in metres."),
    ] = None,
    laps: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="How many; 0 drives until stopped [default: 0, or 1 with --wait]."
        ),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(metavar="M/S", help="Speed along the path.")
    ] = None,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait", help="Return when done, with the tracking numbers; Ctrl-C stops the robot."
        ),
    ] = False,
    replace: Annotated[
        bool, typer.Option("--replace", help="Take the place of a drive under way.")
    ] = False,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Drive a square, a circle or a figure-eight.

    What is not given comes from the daemon's configuration. With --wait the drive ends with this
    command: Ctrl-C, SIGHUP and SIGTERM ramp the robot down, a second Ctrl-C is the emergency stop,
    and a lost connection ramps down as well. Without --wait the robot drives on.

    \b
    Examples:
      robotctl drive square
      robotctl drive square --side 2 --laps 3 --wait
      robotctl drive circle --radius 0.5 --speed 0.2 --replace
    """
    if side is not None and pattern is not Pattern.SQUARE:
        raise UsageError(f"a {pattern.value} has no side", "use --radius")
    if radius is not None and pattern is Pattern.SQUARE:
        raise UsageError("a square has no radius", "use --side")
    _check("--side", side, MIN_SIZE_M, MAX_SIZE_M, " m")
    _check("--radius", radius, MIN_SIZE_M, MAX_SIZE_M, " m")
    _check("--speed", speed, MIN_SPEED_MPS, MAX_SPEED_MPS, " m/s")
    _check("--laps", laps, 0, MAX_LAPS)
    params = {
        "pattern": pattern.value,
        "side_m": side,
        "radius_m": radius,
        "laps": laps,
        "speed_mps": speed,
        "replace": replace,
        "wait": wait,
        "source": source("drive"),
    }
    answer = _drive_and_wait(robot, params, as_json=as_json) if wait else call(robot, DRIVE, params)
    lines = [printable(answer.get("message", "done"))]
    if wait:
        lines += tracking_lines(answer)
    tell(answer, lines, as_json=as_json)


def _check(option: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """Raise UsageError for a value that no robot takes; the daemon's own limits may be lower."""
    if value is not None and not low <= value <= high:  # so is NaN
        raise UsageError(f"{option} {value:g}", f"use {low:g} to {high:g}{unit}")


def _drive_and_wait(robot: str, params: dict[str, Any], *, as_json: bool) -> DriveAnswer:
    """Return what the daemon answers when the drive is done, with the live view until then.

    A drive that was stopped shows its numbers as well. Raises Interrupted once the robot stands.
    """
    with interrupted_by(LOST):
        driving: Background[DriveAnswer] = Background(
            partial(call, robot, DRIVE, params, deadline_s=None)
        )
        try:
            driving.start()  # here, for it may be interrupted when the request is sent already
            if is_terminal() and not as_json:
                show(polled_until(driving, robot))
            else:
                wait_while_read(driving)
            return driving.result()
        except KeyboardInterrupt:
            error: RobotctlError = stopped(robot, driving)
        except RobotctlError as refused:
            error = refused
    if error.answer and not as_json:
        tell(dict(error.answer), tracking_lines(error.answer), as_json=False, error=error)
    raise error


def tracking_lines(result: Mapping[str, Any]) -> list[str]:
    """How well the path was followed, from the result of a drive that was waited for."""
    rms, worst, closure, distance = (
        number(result.get(key), ".3f")
        for key in ("cross_track_rms_m", "cross_track_max_m", "closure_m", "distance_m")
    )
    laps = result.get("laps")
    lines = [
        f"  driven      {laps} {'lap' if laps == 1 else 'laps'}, {distance} m",
        f"  off track   {rms} m RMS, {worst} m at most",
    ]
    if laps:  # before a lap is whole there is nothing to close
        lines.append(f"  closure     {closure} m between start and end")
    return lines
