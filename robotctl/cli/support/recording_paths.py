"""Find recordings: in a given folder, in ./recordings, or where a daemon records."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from robotctl.cli.ui.text import short_path
from robotctl.errors import IN_PARENTHESES, Refused, UsageError
from robotctl.ipc.client import command_for
from robotctl.paths import (
    DEFAULT_ROBOT,
    ROBOT_VARIABLE,
    chain_to,
    recordings_note_path,
    state_folder,
)
from robotctl.regular_file import open_regular

LAST = "last"

_NAME = re.compile(r"(.+)_(\d{8}_\d{6})(?:-(\d+))?")
"""ROBOT_DATE_TIME, with a number if several were started in the same second."""

MAX_PATH_BYTES = 4096
"""PATH_MAX of Linux."""

RecordingsFolder = Annotated[
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
    """Return the folder `given`, else ./recordings, else the folder of the last daemon.

    ./recordings is taken if it holds a recording (of `robot`, unless that is None). The last daemon
    is the one of `robot`, or of any robot, that was started last.

    Raises:
        UsageError: `given` is not a folder, or another user could have changed the note that
            names the daemon's folder.
    """
    if given is not None:
        if not given.is_dir():
            raise UsageError(f"--recordings {given}: no such folder")
        return given
    here = Path("recordings")
    if not recordings_of(robot, here):
        for noted in noted_folders(robot):
            if noted.is_dir():
                return noted
    return here.absolute()


def file_path(text: str) -> Path:
    """Return what an argument names: a path of this computer, or a URL of one file.

    Raises:
        UsageError: It is another URL.
    """
    from robotctl.store.remote_file import path_of

    return path_of(text)


def recording_path(text: str) -> Path:
    """Return what an argument names: a path of this computer.

    Raises:
        UsageError: It is a URL.
    """
    from robotctl.store.remote_file import RemoteFile, not_here

    path = file_path(text)
    if isinstance(path, RemoteFile):
        raise not_here(text)
    return path


def find_recording(
    name: str, robot: str | None, given: Path | None = None, *, also_url: bool = False
) -> Path:
    """Return the path of a recording: a path, a name in the folder of recordings, or `last`.

    A name that is not found is returned as it is; opening it then fails with the reason. With
    `also_url` it may be a URL of one file, too.

    Raises:
        Refused: `name` is `last`, and there is no recording.
        UsageError: It is a URL.
    """
    path = file_path(name) if also_url else recording_path(name)
    if "://" in name:
        return path
    if os.path.exists(name):  # unlike Path.exists, False if permission is denied
        return path
    folder = recordings_folder(robot, given)
    if name == LAST:
        newest = recordings_of(robot, folder)
        if not newest:
            whose = "" if robot is None else f" of robot {robot!r}"
            raise Refused(
                f"no recording{whose} in {folder}",
                f"start one: {command_for(robot or DEFAULT_ROBOT, 'start')}",
                sentence=IN_PARENTHESES,
            )
        return newest[0]
    return folder / name if os.path.exists(folder / name) else path


def cure_of_damage(path: Path) -> str:
    """Return what to do about a recording that cannot be read completely."""
    if "://" in str(path):
        return "download it, and save what can be read with robotctl recover"
    return f"save what can be read: robotctl recover {quote(short_path(path))}"


def recordings_of(robot: str | None, folder: Path) -> list[Path]:
    """Return the recordings of `robot`, or of any robot, in `folder`, newest first.

    A recording is a folder whose name has the form that a daemon gives it; the name also holds the
    time.
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
    """Return the robot in the name of a recording, or None if the name has another form."""
    match = _NAME.fullmatch(recording.name)
    return match[1] if match else None


def noted_folders(robot: str | None) -> Iterator[Path]:
    """Yield the folders that the daemons of `robot`, or of any robot, recorded to, latest first.

    Raises:
        UsageError: Another user could have changed a note that names one of them.
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
