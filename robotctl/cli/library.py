"""Where recordings are: those of the running daemon or, where none runs, of the last one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from robotctl.errors import Refused, UsageError
from robotctl.paths import recordings_note_path

LAST = "last"

Recordings = Annotated[
    Path | None,
    typer.Option(
        "--recordings",
        metavar="DIR",
        help="The folder of recordings [default: the daemon's, or the last daemon's].",
    ),
]


def recordings_folder(robot: str, given: Path | None) -> Path:
    """The folder that was given, or that of the robot's daemon, or ./recordings.

    Raises:
        UsageError: What was given is no folder.
    """
    if given is not None:
        if not given.is_dir():
            raise UsageError(f"--recordings {given}: there is no such folder")
        return given
    try:
        noted = Path(recordings_note_path(robot).read_text(encoding="utf-8").rstrip("\n"))
        if noted.is_dir():
            return noted
    except (OSError, ValueError):
        pass
    return Path("recordings").absolute()


def find_recording(name: str, robot: str, given: Path | None = None) -> Path:
    """The recording that is meant: a path, a name in the folder of recordings, or `last`.

    A name that leads nowhere comes back as it is, for whoever opens it to say so.

    Raises:
        Refused: There is no last one.
    """
    path = Path(name)
    if path.exists():
        return path
    folder = recordings_folder(robot, given)
    if name == LAST:
        newest = recordings_of(robot, folder)
        if not newest:
            raise Refused(
                f"no recording of robot {robot!r} in {folder} (begin one: robotctl start)"
            )
        return newest[0]
    return folder / name if (folder / name).exists() else path


def recordings_of(robot: str, folder: Path) -> list[Path]:
    """The robot's recordings in `folder`, the newest first; by their names, ROBOT_DATE_TIME."""
    pattern = re.compile(re.escape(robot) + r"_(\d{8}_\d{6})(?:-(\d+))?")
    try:
        found = [(pattern.fullmatch(path.name), path) for path in folder.iterdir()]
    except OSError:
        return []
    dated = [(match[1], int(match[2] or 1), path) for match, path in found if match]
    return [path for *_, path in sorted(dated, reverse=True)]
