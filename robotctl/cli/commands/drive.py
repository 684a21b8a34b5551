"""drive: drive a pattern, a velocity, or a path from a file, a recording or a topic."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from math import ceil, degrees, isfinite, radians
from pathlib import Path
from typing import Annotated, Any

import typer

from robotctl.base.errors import RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.commands.status import polled_until, show
from robotctl.cli.options import Json, Reason, Robot, new_app
from robotctl.cli.targets.driving import (
    CLOSING_SIGNALS,
    Background,
    interrupted_by,
    stop_drive,
    wait_while_stdout_open,
)
from robotctl.cli.targets.requests import asked_by, lease_of_shell
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import is_float, is_terminal, number, printable, short_path
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import DRIVE, DRIVE_PATH, DRIVE_VELOCITY, PATH, STATUS, MethodName
from robotctl.ipc.protocol import MAX_REASON
from robotctl.kernel.course import (
    MAX_ANGLE_RAD,
    MAX_CORNER_M,
    MAX_HELD_S,
    MIN_ANGLE_RAD,
    MIN_CORNER_M,
    MIN_HELD_S,
    Frame,
)
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
from robotctl.recording.format.names import PICTURE_FILE
from robotctl.show.figure import Path2D, path_figure
from robotctl.show.png import write_path_png


def leave_picture(robot: str, drive: Mapping[str, Any]) -> Path | None:
    """Draw the last drive into the folder of its recording, and return the path of the picture.

    `drive` is the daemon's answer about the drive. If drawing fails, print a note on stderr and
    return None.
    """
    try:
        path = call(robot, PATH)
        folder = Path(call(robot, STATUS)["recorder"]["file"]).parent
        return write_picture(folder, robot, path["reference"], path["driven"], drive)
    except RobotctlError as error:
        reason = str(error)
    except OSError as error:
        reason = error.strerror or repr(error)
    print(f"note: no {PICTURE_FILE} was drawn: {printable(reason)}", file=sys.stderr)
    return None


def write_picture(
    folder: Path, robot: str, reference: Path2D, driven: Path2D, drive: Mapping[str, Any]
) -> Path:
    """Draw a drive's reference and driven path into PICTURE_FILE in `folder`; return its path.

    Raises:
        OSError: The file cannot be written.
    """
    rms, worst = (
        number(drive.get(key), ".3f") for key in ("cross_track_rms_m", "cross_track_max_m")
    )
    picture = folder / PICTURE_FILE
    known = drive.get("cross_track_rms_m") is not None
    title = f"{robot}: off track {rms} m RMS, {worst} m at most" if known else robot
    write_path_png(picture, path_figure(reference, driven, title))
    return picture


def drive_and_wait(
    robot: str, method: MethodName[DriveAnswer], params: dict[str, Any], *, as_json: bool
) -> dict[str, Any]:
    """Request a drive, wait for its end, and return the daemon's answer with the key `picture`.

    `picture` is the path of the drive's picture, or None. On a terminal, the drive is shown live,
    unless `as_json`.

    Raises:
        Interrupted: Ctrl-C or a signal ended the drive; the robot stands.
        RobotctlError: The drive was refused, or ended by a fault.
    """
    with interrupted_by(CLOSING_SIGNALS):
        driving: Background[DriveAnswer] = Background(
            partial(call, robot, method, params, deadline_s=None)
        )
        try:
            driving.start()  # inside the `try`: an interrupt may come after the request was sent
            if is_terminal() and not as_json:
                show(polled_until(driving, robot))
            else:
                wait_while_stdout_open(driving)
            answer = driving.result()
        except KeyboardInterrupt:
            error: RobotctlError = stop_drive(robot, driving)
        except RobotctlError as refused:
            error = refused
        else:
            return _with_picture(robot, answer)
    if error.answer:
        error.answer = _with_picture(robot, error.answer)
        if not as_json:
            lines = tracking_lines(error.answer)
            print_answer(error.answer, lines, as_json=False, error=error)
    raise error


def _with_picture(robot: str, answer: Mapping[str, Any]) -> dict[str, Any]:
    picture = leave_picture(robot, answer)
    return {**answer, "picture": None if picture is None else str(picture)}


def tracking_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the lines to print about a drive: distance, errors and picture."""
    rms, worst, closure, distance = (
        number(result.get(key), ".3f")
        for key in ("cross_track_rms_m", "cross_track_max_m", "closure_m", "distance_m")
    )
    laps = result.get("laps")
    heading_rms, heading_worst, seconds = (
        number(result.get(key), form)
        for key, form in (
            ("heading_rms_rad", ".3f"),
            ("heading_max_rad", ".3f"),
            ("duration_s", ".1f"),
        )
    )
    lines = [f"  driven      {laps} {'lap' if laps == 1 else 'laps'}, {distance} m in {seconds} s"]
    if result.get("cross_track_rms_m") is not None:
        lines.append(f"  off track   {rms} m RMS, {worst} m at most")
    if result.get("heading_rms_rad") is not None:
        lines.append(f"  heading     {heading_rms} rad RMS, {heading_worst} rad at most")
    if result.get("true_cross_track_rms_m") is not None:
        lines.append(_true_line(result))
    if laps:  # no closure before the first lap is complete
        lines.append(f"  closure     {closure} m from where the lap ends")
    if result.get("picture"):
        lines.append(f"  picture     {short_path(result['picture'])}")
    return lines


def _true_line(result: Mapping[str, Any]) -> str:
    """Return a line with the errors by the true pose of a simulated robot."""
    rms, worst, heading, closure = (
        number(result.get(f"true_{name}"), ".3f")
        for name in ("cross_track_rms_m", "cross_track_max_m", "heading_rms_rad", "closure_m")
    )
    closed = f", {closure} m closure" if result.get("true_closure_m") is not None else ""
    return f"  in truth    {rms} m RMS, {worst} m at most, {heading} rad{closed}"


PATTERNS = ", ".join(kind.value for kind in PatternKind)
PATH_MOTION, VELOCITY_MOTION = "path", "velocity"
MOTIONS = (*(kind.value for kind in PatternKind), PATH_MOTION, VELOCITY_MOTION)

FOLLOWED = frozenset({"laps", "speed", "reverse", "open-loop"})
"""The options of every motion that follows a path."""

_OWNERS = {
    "frame": "the path of a file",
    "topic": "a path",
    "for": "a velocity",
    "corner": "a rounded-square or a path",
    "angle": "an arc or a turn",
}
"""The motions that have an option, for errors."""


def checked_values(motion: str, given: Sequence[str] | None, topic: str = "") -> list[str]:
    """Return the checked arguments of a motion, [] for a path that comes from a `topic`.

    Raises:
        UsageError: There is no such motion, or its arguments are too many, too few or wrong.
    """
    values = list(given or ())
    for value in (motion, *values):
        if value.startswith("-") and not is_float(value):
            raise UsageError(f"No such option: {printable(value)}")
    if motion not in MOTIONS:
        shown = f"{printable(motion)!r} is not one of"
        wrong = shown if motion else "Missing argument 'PATTERN'. Choose from:"
        raise UsageError(f"{wrong} {', '.join(MOTIONS)}")
    if motion == VELOCITY_MOTION:
        if len(values) != 2 or not all(map(_is_number, values)):
            raise UsageError("a velocity is two numbers", "such as robotctl drive velocity 0.2 0")
    elif motion == PATH_MOTION and topic:
        if values:
            raise UsageError("a path has one FILE or one --topic, not both")
    elif motion == PATH_MOTION and (len(values) != 1 or not values[0]):
        cure = "use CSV with the header x,y, YAML, or a recording"
        raise UsageError("a path has one FILE" if any(values) else "a path needs a FILE", cure)
    elif motion != PATH_MOTION and values:
        raise UsageError(f"a {motion} has no file", "use robotctl drive path FILE")
    return values


def options_of(pattern: PatternKind) -> frozenset[str]:
    """Return the names of the options that a pattern accepts."""
    shape = SHAPES[pattern]
    size = {shape.size_name.value} if shape.size_name else set()
    corner = {"corner"} if shape.has_corner else set()
    return FOLLOWED | size | corner | ({"angle"} if shape.has_angle else set())


def refuse_options(
    what: str, options: Mapping[str, object], *, allowed: Collection[str], cure: str = ""
) -> None:
    """Check that only options in `allowed` are given; one with the value None is not given.

    `what` is the motion's name in the error, and `cure` is the advice about a wrong size.

    Raises:
        UsageError: An option that is not allowed is given.
    """
    for name, value in options.items():
        if value is not None and name not in allowed:
            if name in _OWNERS:
                cure = f"it is for {_OWNERS[name]}"
            elif name in FOLLOWED:
                cure = ""
            raise UsageError(f"{what} has no --{name}", cure)


def velocity_params(values: Sequence[str], duration: str | None) -> dict[str, Any]:
    """Return the parameters of the request for a velocity.

    Raises:
        UsageError: The duration is missing or not allowed.
    """
    seconds = (duration or "").removesuffix("s")
    for_s = float(seconds) if _is_number(seconds) else 0.0
    if not MIN_HELD_S <= for_s <= MAX_HELD_S:
        text = f"--for {printable(duration)}" if duration else "a velocity needs --for"
        raise UsageError(text, f"use {MIN_HELD_S:g} to {MAX_HELD_S:g} s, such as --for 2s")
    linear_mps, angular_rps = map(float, values)
    return {"linear_mps": linear_mps, "angular_rps": angular_rps, "for_s": for_s}


def _is_number(text: str) -> bool:
    return is_float(text) and isfinite(float(text))


app = new_app()

MIN_ANGLE_DEG = ceil(100.0 * degrees(MIN_ANGLE_RAD)) / 100.0
MAX_ANGLE_DEG = float(int(degrees(MAX_ANGLE_RAD)))


@app.command(context_settings={"ignore_unknown_options": True})
def drive(
    motion: Annotated[
        str,
        typer.Argument(
            metavar="PATTERN", help=f"One of {PATTERNS}; or {PATH_MOTION}, {VELOCITY_MOTION}."
        ),
    ] = "",
    given: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE | V W]",
            help="Of a path: CSV with the header x,y, YAML, or a recording by its path or name; "
            "last: the newest one in which the robot drove. Of a velocity: forward in m/s, to the "
            "left in rad/s.",
        ),
    ] = None,
    duration: Annotated[
        str | None, typer.Option("--for", metavar="S", help="How long to command a velocity, 2s.")
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
    reverse: Annotated[
        bool,
        typer.Option(
            "--reverse",
            help="Drive rear first: a pattern lies behind the robot, the points of a path stay.",
        ),
    ] = False,
    topic: Annotated[
        str,
        typer.Option(metavar="NAME", help="Of a path: the next nav_msgs/Path on this topic."),
    ] = "",
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
            "--wait",
            help="Wait for the end, print the tracking error and draw path.png; Ctrl-C stops.",
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
    Ctrl-C is the emergency stop. path.png beside the recording shows the last drive. Without
    --wait the robot continues after this command.

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
      robotctl drive path --topic plan
      robotctl drive velocity 0.2 -0.5 --for 2s
    """
    values = checked_values(motion, given, topic)
    _check("--speed", speed, MIN_SPEED_MPS, MAX_SPEED_MPS, " m/s")
    _check("--laps", laps, 0, MAX_LAPS)
    sizes = {SizeName.SIDE: side, SizeName.RADIUS: radius, SizeName.LENGTH: length}
    options: dict[str, float | str | bool | None] = {
        **{name.value: size for name, size in sizes.items()},
        "corner": corner,
        "angle": angle,
        "for": duration,
        "topic": topic or None,
        "frame": None if frame is Frame.START else frame.value,
        "laps": laps,
        "speed": speed,
        "reverse": reverse or None,
        "open-loop": open_loop or None,
    }
    params: dict[str, Any] = {
        "replace": replace,
        "wait": wait,
        **asked_by("drive", reason),
        **lease_of_shell(),
    }
    followed = {
        "corner_m": corner,
        "reverse": reverse,
        "open_loop": open_loop,
        "laps": laps,
        "speed_mps": speed,
    }
    method = DRIVE
    if motion == VELOCITY_MOTION:
        refuse_options("a velocity", options, allowed={"for"})
        method, params = DRIVE_VELOCITY, params | velocity_params(values, duration)
    elif motion == PATH_MOTION:
        own = {"corner", "topic"} if topic else {"corner", "frame"}
        what = "a path of a topic" if topic else "a path"
        refuse_options(what, options, allowed=FOLLOWED | own)
        _check("--corner", corner, 0.0, MAX_CORNER_M, " m")
        from robotctl.cli.commands.drive_paths import heard_path, read_waypoints

        if topic:
            full_name, points, frame = heard_path(robot, topic)
            params["reason"] = reason or f"the path of {full_name}"[:MAX_REASON]
        else:
            points = read_waypoints(values[0], frame, robot)
        method = DRIVE_PATH
        params |= followed | {"points": points, "frame": frame.value}
    else:
        pattern = PatternKind(motion)
        size_name = SHAPES[pattern].size_name
        cure = f"use --{size_name.value}" if size_name else ""
        refuse_options(f"a {motion}", options, allowed=options_of(pattern), cure=cure)
        for name, size in sizes.items():
            _check(f"--{name.value}", size, MIN_SIZE_M, MAX_SIZE_M, " m")
        _check("--corner", corner, MIN_CORNER_M, MAX_CORNER_M, " m")
        if angle is not None and not MIN_ANGLE_DEG <= abs(angle) <= MAX_ANGLE_DEG:
            cure = f"use {MIN_ANGLE_DEG:g} to {MAX_ANGLE_DEG:g} degrees, with a minus to the right"
            raise UsageError(f"--angle {angle:g}", cure)
        params |= followed
        params |= {"pattern": motion, "side_m": side, "radius_m": radius, "length_m": length}
        params["angle_rad"] = None if angle is None else radians(angle)
    if wait:
        answer = drive_and_wait(robot, method, params, as_json=as_json)
    else:
        answer = {**call(robot, method, params)}
    lines = [printable(answer.get("message", "done"))]
    if wait and motion == VELOCITY_MOTION:
        lines.append(f"  driven      {number(answer.get('distance_m'), '.3f')} m")
    elif wait:
        lines += tracking_lines(answer)
    print_answer(answer, lines, as_json=as_json)


def _check(option: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """Check that the value of `option`, if given, is within `low` and `high`.

    Raises:
        UsageError: The value is out of range.
    """
    if value is not None and not low <= value <= high:  # NaN is refused, too
        raise UsageError(f"{option} {value:g}", f"use {low:g} to {high:g}{unit}")
