"""Where recordings are: in a folder that is named, in the one at hand, or in a daemon's."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.quick import ROBOT_VARIABLE
from robotctl.errors import IN_PARENTHESES, Refused, UsageError
from robotctl.ipc.client import command_for
from robotctl.paths import DEFAULT_ROBOT, chain_to, recordings_note_path, state_folder
from robotctl.regular_file import open_regular

LAST = "last"

_NAME = re.compile(r"(.+)_(\d{8}_\d{6})(?:-(\d+))?")
"""ROBOT_DATE_TIME, with a number where several began in the same second."""

MAX_PATH_BYTES = 4096
"""PATH_MAX of Linux: no folder of recordings has a longer path."""

Recordings = Annotated[
    Path | None,
    typer.Option(
        "--recordings",
        metavar="DIR",
        help="The folder of recordings [default: ./recordings, or the daemon's, or the last "
        "daemon's].",
    ),
]

RecordedBy = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="NAME",
        envvar=ROBOT_VARIABLE,
        show_envvar=True,
        help="Only recordings of this robot [default: any].",
    ),
]


def recordings_folder(robot: str | None, given: Path | None) -> Path:
    """Return the folder that was given, else ./recordings, else that of a daemon.

    ./recordings counts where it holds a recording (of `robot`, unless that is None). The daemon is
    the one of `robot`, or of any robot, that was started last.

    Raises:
        UsageError: `given` is no folder, or another user could have named the daemon's.
    """
    if given is not None:
        if not given.is_dir():
            raise UsageError(f"--recordings {given}: there is no such folder")
        return given
    here = Path("recordings")
    if not recordings_of(robot, here):
        for noted in _noted_folders(robot):
            if noted.is_dir():
                return noted
    return here.absolute()


def find_recording(name: str, robot: str | None, given: Path | None = None) -> Path:
    """Return the recording that is meant: a path, a name in the folder of recordings, or `last`.

    A name that leads nowhere is returned as it is, so that whatever opens it can say so.

    Raises:
        Refused: There is no last one.
    """
    path = Path(name)
    if os.path.exists(name):  # and is no error where that may not be known
        return path
    folder = recordings_folder(robot, given)
    if name == LAST:
        newest = recordings_of(robot, folder)
        if not newest:
            whose = "" if robot is None else f" of robot {robot!r}"
            raise Refused(
                f"no recording{whose} in {folder}",
                f"begin one: {command_for(robot or DEFAULT_ROBOT, 'start')}",
                sentence=IN_PARENTHESES,
            )
        return newest[0]
    return folder / name if os.path.exists(folder / name) else path


def recordings_of(robot: str | None, folder: Path) -> list[Path]:
    """Return the recordings in `folder`, of one robot or of any, the newest first by their names.

    A recording is a folder with the name that a daemon gives it.
    """
    try:
        found = [(_NAME.fullmatch(path.name), path) for path in folder.iterdir()]
    except OSError:
        return []
    dated = [
        (match[2], int(match[3] or 1), path)
        for match, path in found
        if match and robot in (None, match[1]) and path.is_dir()
    ]
    return [path for *_, path in sorted(dated, reverse=True)]


def robot_of(recording: Path) -> str | None:
    """Return the robot that the name of a recording names; None where it names none."""
    match = _NAME.fullmatch(recording.name)
    return match[1] if match else None


def _noted_folders(robot: str | None) -> Iterator[Path]:
    """Yield where the robot's daemons have recorded, or those of any robot, the last one first.

    Raises UsageError if another user could have named one of them.
    """
    note = recordings_note_path(robot or DEFAULT_ROBOT)
    notes = [note]
    if robot is None:
        notes = sorted(state_folder().glob(f"*/{note.name}"), key=_changed_s, reverse=True)
    for note in notes:
        try:
            chain_to(note.parent).check()
            with open_regular(note) as file:
                noted = file.read(MAX_PATH_BYTES).decode().rstrip("\n")
        except (OSError, ValueError):
            continue
        yield Path(noted)


def _changed_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
