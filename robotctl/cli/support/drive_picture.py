"""The picture of a drive, beside its recording: the path driven over the wanted one."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robotctl.cli.ui.text import number, printable
from robotctl.errors import RobotctlError
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PATH, STATUS
from robotctl.recording.format.names import PICTURE_FILE
from robotctl.show.figure import Path2D, path_figure
from robotctl.show.png import write_path_png


def leave_picture(robot: str, drive: Mapping[str, Any]) -> Path | None:
    """Draw the last drive of a robot beside its recording, and return where; it replaces a picture.

    `drive` is the answer that tells its figures. The drive is over and recorded, so a picture that
    fails is no error: a note on stderr says why, and None is returned.
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
    """Write the picture into a folder, and return its path.

    Raises:
        OSError: It cannot be written.
    """
    rms, worst = (
        number(drive.get(key), ".3f") for key in ("cross_track_rms_m", "cross_track_max_m")
    )
    picture = folder / PICTURE_FILE
    known = drive.get("cross_track_rms_m") is not None
    title = f"{robot}: off track {rms} m RMS, {worst} m at most" if known else robot
    write_path_png(picture, path_figure(reference, driven, title))
    return picture
