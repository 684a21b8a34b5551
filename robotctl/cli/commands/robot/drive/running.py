"""Run a drive that ends with its command: wait for its end, and draw its picture."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from robotctl.base.errors import RobotctlError
from robotctl.cli.commands.daemon.watch import polled_until, show
from robotctl.cli.targets.driving import (
    CLOSING_SIGNALS,
    stop_drive,
    wait_while_stdout_open,
)
from robotctl.cli.targets.interrupts import Background, interrupted_by
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import is_terminal, number, printable, short_path
from robotctl.ipc.answers import DriveAnswer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PATH, STATUS, MethodName
from robotctl.recording.format.names import PICTURE_FILE
from robotctl.show.figure import Path2D, path_figure
from robotctl.show.png import write_path_png


def leave_picture(robot: str, drive: Mapping[str, Any]) -> Path | None:
    """Draw the last drive into the folder of its recording, and return the path of the picture.

    `drive` is the daemon's answer about the drive. An earlier picture is replaced. If drawing
    fails, a note on stderr says why, and None is returned: the drive is recorded all the same.
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
    """Draw a drive's reference and driven path into PICTURE_FILE in `folder`; return the file.

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
    """Request a drive, wait until it ends, and return the daemon's answer with the key `picture`.

    On a terminal, the drive is shown live, unless `as_json`. If the drive was stopped, its figures
    are printed before the error is raised.

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
    """Return the lines to print about a drive: distance, errors, and the path of its picture."""
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
