"""The options of `robotctl drive`, and what they request."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, radians
from typing import Annotated, Any

import typer

from robotctl.cli.commands.drive.running import drive_and_wait, tracking_lines
from robotctl.cli.commands.drive.waypoint_file import read_waypoints
from robotctl.cli.options import Json, Reason, Robot, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.quick_actions import asked_by, lease_of_shell
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
from robotctl.ipc.client import call
from robotctl.ipc.method_names import DRIVE, DRIVE_PATH
from robotctl.kernel.course import MAX_ANGLE_RAD, MAX_CORNER_M, MIN_CORNER_M, Frame
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

PATH = "path"
MOTIONS = [*(kind.value for kind in PatternKind), PATH]


@app.command()
def drive(
    motion: Annotated[
        str, typer.Argument(metavar="PATTERN", help=f"One of {PATTERNS}; or {PATH}, with a FILE.")
    ] = "",
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE]",
            help="Of a path: CSV with the header x,y, YAML, or a recording; last: the newest one.",
        ),
    ] = None,
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
        typer.Option(
            metavar="M",
            help="Radius of the corners of a rounded-square; on a path, how far before a corner "
            "its arc begins, 0 to stop and turn at each point. In metres.",
        ),
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
    frame: Annotated[
        Frame, typer.Option(help="Where the points of a path are: start is the present pose.")
    ] = Frame.START,
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
    """Drive a pattern, such as a square, a line or a turn on the spot, or a path.

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
      robotctl drive path points.csv --wait
      robotctl drive path last --speed 0.3
    """
    if motion not in MOTIONS:
        wrong = (
            f"{motion!r} is not one of" if motion else "Missing argument 'PATTERN'. Choose from:"
        )
        raise UsageError(f"{wrong} {', '.join(MOTIONS)}")
    _check("--speed", speed, MIN_SPEED_MPS, MAX_SPEED_MPS, " m/s")
    _check("--laps", laps, 0, MAX_LAPS)
    sizes = {SizeName.SIDE: side, SizeName.RADIUS: radius, SizeName.LENGTH: length}
    params: dict[str, Any] = {
        "corner_m": corner,
        "reverse": reverse,
        "open_loop": open_loop,
        "laps": laps,
        "speed_mps": speed,
        "replace": replace,
        "wait": wait,
        **asked_by("drive", reason),
        **lease_of_shell(),
    }
    if motion == PATH:
        method = DRIVE_PATH
        params |= _path_params(file, frame, sizes, angle)
        _check("--corner", corner, 0.0, MAX_CORNER_M, " m")
    else:
        method = DRIVE
        params |= _pattern_params(PatternKind(motion), file, frame, sizes, corner, angle)
    if wait:
        answer = drive_and_wait(robot, method, params, as_json=as_json)
    else:
        answer = call(robot, method, params)
    lines = [printable(answer.get("message", "done"))]
    if wait:
        lines += tracking_lines(answer)
    print_answer(answer, lines, as_json=as_json)


def _path_params(
    file: str | None, frame: Frame, sizes: Mapping[SizeName, float | None], angle: float | None
) -> dict[str, Any]:
    """Return what a path takes beyond every drive.

    Raises:
        UsageError: There is no file, or an option does not fit a path.
        UnreadableFile: The file holds no path.
    """
    if file is None:
        raise UsageError("a path needs a FILE", "use CSV with the header x,y, YAML, or a recording")
    for name, given in (*((name.value, size) for name, size in sizes.items()), ("angle", angle)):
        if given is not None:
            raise UsageError(f"a path has no {name}")
    return {"points": read_waypoints(file, frame), "frame": frame.value}


def _pattern_params(
    pattern: PatternKind,
    file: str | None,
    frame: Frame,
    sizes: Mapping[SizeName, float | None],
    corner: float | None,
    angle: float | None,
) -> dict[str, Any]:
    """Return what a pattern takes beyond every drive.

    Raises:
        UsageError: An option does not fit the pattern.
    """
    if file is not None:
        raise UsageError(f"a {pattern.value} has no file", "use robotctl drive path FILE")
    if frame is not Frame.START:
        raise UsageError("a pattern begins at the robot", "use --frame with robotctl drive path")
    _check_shape(pattern, sizes, corner, angle)
    for name, size in sizes.items():
        _check(f"--{name.value}", size, MIN_SIZE_M, MAX_SIZE_M, " m")
    _check("--corner", corner, MIN_CORNER_M, MAX_CORNER_M, " m")
    _check("--angle", angle, -MAX_ANGLE_DEG, MAX_ANGLE_DEG, " degrees")
    return {
        "pattern": pattern.value,
        "side_m": sizes[SizeName.SIDE],
        "radius_m": sizes[SizeName.RADIUS],
        "length_m": sizes[SizeName.LENGTH],
        "angle_rad": None if angle is None else radians(angle),
    }


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
