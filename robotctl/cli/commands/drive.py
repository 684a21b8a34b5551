"""drive: drive a pattern of a given size."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import degrees, radians
from typing import Annotated, Any

import typer

from robotctl.cli.commands.watch import polled_until, show
from robotctl.cli.options import Json, Reason, Robot, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.background import Background
from robotctl.cli.support.interrupted_drive import (
    CLOSING_SIGNALS,
    stop_drive,
    wait_while_stdout_open,
)
from robotctl.cli.support.quick_actions import asked_by, lease_of_shell
from robotctl.cli.support.signals import interrupted_by
from robotctl.cli.terminal.text import is_terminal, number, printable
from robotctl.errors import RobotctlError, UsageError
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import DRIVE
from robotctl.kernel.course import MAX_ANGLE_RAD, MAX_CORNER_M, MIN_CORNER_M
from robotctl.kernel.drive import MAX_LAPS
from robotctl.kernel.patterns import (
    MAX_SIZE_M,
    MAX_SPEED_MPS,
    MIN_SIZE_M,
    MIN_SPEED_MPS,
    SHAPES,
    PatternKind,
    SizeName,
)
from robotctl.paths import DEFAULT_ROBOT

app = new_app()

MAX_ANGLE_DEG = float(int(degrees(MAX_ANGLE_RAD)))

PATTERNS = ", ".join(kind.value for kind in PatternKind)


@app.command()
def drive(
    pattern: Annotated[PatternKind, typer.Argument(metavar="PATTERN", help=f"One of {PATTERNS}.")],
    side: Annotated[
        float | None, typer.Option(metavar="M", help="Side of a square, in metres.")
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(metavar="M", help="Radius of a circle, a loop or an arc, in metres."),
    ] = None,
    length: Annotated[
        float | None, typer.Option(metavar="M", help="Length of the line, in metres.")
    ] = None,
    angle: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="How far to turn, in degrees; to the left if positive."),
    ] = None,
    corner: Annotated[
        float | None,
        typer.Option(metavar="M", help="Radius of the corners of a rounded-square, in metres."),
    ] = None,
    laps: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Number of laps; 0: until stopped [default: 0; 1 with --wait, and where the "
            "pattern does not end where it begins].",
        ),
    ] = None,
    reverse: Annotated[bool, typer.Option("--reverse", help="Drive rear first.")] = False,
    open_loop: Annotated[
        bool, typer.Option("--open-loop", help="Do not correct by odometry, for comparison.")
    ] = False,
    speed: Annotated[
        float | None, typer.Option(metavar="M/S", help="Speed along the path.")
    ] = None,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait", help="Wait for the end, then print the tracking error; Ctrl-C stops."
        ),
    ] = False,
    reason: Reason = "",
    replace: Annotated[bool, typer.Option("--replace", help="Replace the current drive.")] = False,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Drive a pattern: a square, a circle, a line, a turn on the spot and others.

    Size and speed default to the daemon's configuration. With --wait the drive ends with this
    command: Ctrl-C, SIGHUP, SIGTERM and a lost connection ramp the robot down, and a second
    Ctrl-C is the emergency stop. Without --wait the robot continues after this command.

    \b
    Examples:
      robotctl drive square
      robotctl drive square --side 2 --laps 3 --wait
      robotctl drive circle --radius 0.5 --speed 0.2 --replace
      robotctl drive rounded-square --side 1 --corner 0.1 --wait
      robotctl drive line --length 2 --reverse
      robotctl drive turn --angle -90
    """
    sizes = {SizeName.SIDE: side, SizeName.RADIUS: radius, SizeName.LENGTH: length}
    _check_shape(pattern, sizes, corner, angle)
    for name, size in sizes.items():
        _check(f"--{name.value}", size, MIN_SIZE_M, MAX_SIZE_M, " m")
    _check("--corner", corner, MIN_CORNER_M, MAX_CORNER_M, " m")
    _check("--angle", angle, -MAX_ANGLE_DEG, MAX_ANGLE_DEG, " degrees")
    _check("--speed", speed, MIN_SPEED_MPS, MAX_SPEED_MPS, " m/s")
    _check("--laps", laps, 0, MAX_LAPS)
    params = {
        "pattern": pattern.value,
        "side_m": side,
        "radius_m": radius,
        "length_m": length,
        "corner_m": corner,
        "angle_rad": None if angle is None else radians(angle),
        "reverse": reverse,
        "open_loop": open_loop,
        "laps": laps,
        "speed_mps": speed,
        "replace": replace,
        "wait": wait,
        **asked_by("drive", reason),
        **lease_of_shell(),
    }
    answer = _drive_and_wait(robot, params, as_json=as_json) if wait else call(robot, DRIVE, params)
    lines = [printable(answer.get("message", "done"))]
    if wait:
        lines += tracking_lines(answer)
    print_answer(answer, lines, as_json=as_json)


def _check_shape(
    pattern: PatternKind,
    sizes: Mapping[SizeName, float | None],
    corner: float | None,
    angle: float | None,
) -> None:
    """Raise UsageError for an option that the pattern does not have."""
    shape = SHAPES[pattern]
    cure = f"use --{shape.size_name.value}" if shape.size_name else ""
    given = [name for name, size in sizes.items() if size is not None]
    unused = [name.value for name in given if name is not shape.size_name]
    if corner is not None and not shape.has_corner:
        unused.append("rounded corner")
    if angle is not None and not shape.has_angle:
        unused.append("angle")
    if unused:
        raise UsageError(f"a {pattern.value} has no {unused[0]}", cure)


def _check(option: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """Raise UsageError for a value out of range; the daemon's own limits may be lower."""
    if value is not None and not low <= value <= high:  # NaN is refused, too
        raise UsageError(f"{option} {value:g}", f"use {low:g} to {high:g}{unit}")


def _drive_and_wait(robot: str, params: dict[str, Any], *, as_json: bool) -> DriveAnswer:
    """Show the live view until the drive ends, and return the daemon's answer.

    For a drive that was stopped, the numbers are printed as well before the error is raised.

    Raises:
        Interrupted: Ctrl-C or a signal ended the drive; the robot stands.
        RobotctlError: The drive was refused, or ended by a fault.
    """
    with interrupted_by(CLOSING_SIGNALS):
        driving: Background[DriveAnswer] = Background(
            partial(call, robot, DRIVE, params, deadline_s=None)
        )
        try:
            driving.start()  # inside the `try`: an interrupt may come after the request was sent
            if is_terminal() and not as_json:
                show(polled_until(driving, robot))
            else:
                wait_while_stdout_open(driving)
            return driving.result()
        except KeyboardInterrupt:
            error: RobotctlError = stop_drive(robot, driving)
        except RobotctlError as refused:
            error = refused
    if error.answer and not as_json:
        print_answer(dict(error.answer), tracking_lines(error.answer), as_json=False, error=error)
    raise error


def tracking_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the lines on distance and tracking error, from the result of a finished drive."""
    rms, worst, closure, distance = (
        number(result.get(key), ".3f")
        for key in ("cross_track_rms_m", "cross_track_max_m", "closure_m", "distance_m")
    )
    laps = result.get("laps")
    lines = [
        f"  driven      {laps} {'lap' if laps == 1 else 'laps'}, {distance} m",
        f"  off track   {rms} m RMS, {worst} m at most",
    ]
    if laps:  # no closure before the first lap is complete
        lines.append(f"  closure     {closure} m between start and end")
    return lines
