"""Find the recordings that a command's arguments name, and the times in them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer

from robotctl.base.errors import IN_PARENTHESES, NoDaemon, Refused, RobotctlError, UsageError
from robotctl.base.files import open_regular
from robotctl.base.paths import (
    DEFAULT_ROBOT,
    ROBOT_VARIABLE,
    chain_to,
    recordings_note_path,
    state_folder,
)
from robotctl.cli.ui.output import progress_bar
from robotctl.cli.ui.text import is_float, short_path
from robotctl.ipc.client import Client, command_for
from robotctl.ipc.method_names import RECORD_COMMIT
from robotctl.kernel.constants import DAY_S, NS_PER_S

if TYPE_CHECKING:
    from robotctl.collection.catalogue import Catalogue


LAST = "last"

_NAME = re.compile(r"(.+)_(\d{8}_\d{6})(?:-(\d+))?")
"""ROBOT_DATE_TIME, with a number if several began in the same second."""

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
    """Return the folder `given`, or else the folder with recordings of `robot`.

    That is ./recordings if it has any, else the last daemon's folder. None means any robot.

    Raises:
        UsageError: `given` is not a folder, or another user could have changed the daemon's note of
            its folder.
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
    """Return `text`, a path or the URL of an MCAP file, as a Path that can be opened.

    Raises:
        UsageError: The URL does not name an MCAP file, or its scheme is not supported.
    """
    from robotctl.base.store import path_of

    return path_of(text)


def recording_path(text: str) -> Path:
    """Return `text` as a path on this computer.

    Raises:
        UsageError: `text` is a URL of a store.
    """
    from robotctl.base.store import RemoteFile, not_here

    path = file_path(text)
    if isinstance(path, RemoteFile):
        raise not_here(text)
    return path


def find_recording(
    name: str, robot: str | None, given: Path | None = None, *, also_url: bool = False
) -> Path:
    """Return the path of the recording `name`: a path, a name in the recordings folder, or `last`.

    A name that is not found is returned as it is. With `also_url`, the URL of a file is allowed.

    Raises:
        Refused: `name` is `last`, and there is no recording.
        UsageError: `name` is a URL that is not allowed.
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


LABEL_WIDTH = 12
"""The width of the column before a path [characters]."""


def select_recordings(
    files: Sequence[Path], robot: str | None, *, also_urls: bool = False
) -> tuple[list[Path], list[Path]]:
    """Return the recordings of `files` (paths, names or `last`), and the paths to skip.

    A folder of recordings stands for all recordings in it. If no path is a recording, all are
    returned, so that reading them reports why.

    Raises:
        Refused: `last` was given and there is no recording.
        UsageError: A URL was given, but not `also_urls`.
    """
    from robotctl.recording.read.files import is_recording

    found = [find_recording(str(file), robot, also_url=also_urls) for file in files]
    skipped = [path for path in found if not is_recording(path)]
    if len(skipped) == len(found):
        skipped = []
    return [each for path in found if path not in skipped for each in _recordings_at(path)], skipped


def skipped_lines(skipped: Sequence[Path]) -> list[str]:
    """Return a line for each path that is not a recording."""
    return [f"{'skipped':{LABEL_WIDTH}}{short_path(path)}: not a recording" for path in skipped]


def _recordings_at(path: Path) -> list[Path]:
    """Return the recording at `path`, or the recordings in this folder."""
    from robotctl.recording.read.files import is_bag

    try:
        if path.is_dir() and not is_bag(path):
            return sorted(filter(is_bag, path.iterdir())) or [path]
    except OSError:
        pass  # the reader of the recording reports why
    return [path]


def cure_of_damage(path: Path) -> str:
    """Return the advice for a recording that cannot be read completely."""
    if "://" in str(path):
        return "download it, and save what can be read with robotctl recover"
    return f"save what can be read: robotctl recover {quote(short_path(path))}"


def recordings_of(robot: str | None, folder: Path) -> list[Path]:
    """Return the recordings of `robot`, or of any robot if None, in `folder`, newest first.

    Only folders with a name ROBOT_DATE_TIME count.
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
    """Return the robot in the name of a recording, or None for another form of name."""
    match = _NAME.fullmatch(recording.name)
    return match[1] if match else None


def noted_folders(robot: str | None) -> Iterator[Path]:
    """Yield the folder in which the last daemon of `robot` recorded.

    If `robot` is None, yield the folders of all robots, the one with the newest note first.

    Raises:
        UsageError: Another user could have changed a note.
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


MAX_RECORDINGS = 20
"""The maximum number of recordings to search."""

COMMIT_DEADLINE_S = 8.0
"""The timeout of a commit [s]; the daemon answers earlier."""


def committed_recording(robot: str, missing: list[str]) -> Path | None:
    """Make the daemon commit its recording to disk; return the recording's folder, None on failure.

    A sentence about messages that the daemon did not write is added to `missing`.
    """
    try:
        with Client(robot) as client:
            try:
                answer = client.call(RECORD_COMMIT, deadline_s=COMMIT_DEADLINE_S)
            except RobotctlError as error:  # busy, stuck, ending, or of another version
                missing.append(f"the messages that the daemon has not written yet: {error}")
                return None
    except (NoDaemon, Refused, UsageError):  # no daemon, or not a valid robot name
        return None
    if answer["uncommitted"]:
        reason = answer["failure"] or "the disk is too slow"
        missing.append(f"{answer['uncommitted']} messages that are not written yet: {reason}")
    return Path(answer["file"]).parent


def with_earlier(newest: Path) -> list[Path]:
    """Return `newest` and earlier recordings of its robot, newest first, MAX_RECORDINGS at most."""
    paths = recordings_of(robot_of(newest), newest.parent)
    if newest not in paths:
        return [newest]
    return paths[paths.index(newest) :][:MAX_RECORDINGS]


@contextmanager
def open_catalogue(given: str | None, *, quiet: bool) -> Iterator[tuple[Path, Catalogue]]:
    """Yield a folder and the catalogue of its indexes; missing and old indexes are made first.

    Raises:
        UsageError: There is no such folder, or duckdb is not installed.
        Refused: The folder cannot be read, or the catalogue cannot be written.
    """
    from robotctl.collection.catalogue import catalogue_of

    place = recordings_folder(None, None) if given is None else recording_path(given)
    if given is not None and not place.is_dir():
        raise UsageError(f"{place}: no such folder")
    try:
        with ExitStack() as stack:
            with progress_bar("indexing", quiet=quiet) as on_progress:
                catalogue = stack.enter_context(catalogue_of(place, on_progress))
            yield place, catalogue
    except OSError as error:
        raise Refused(f"{place} cannot be read: {error.strerror or error}") from error


MAX_SECONDS = 366 * DAY_S


def parse_moment(text: str, start_ns: int, end_ns: int, option: str = "--at") -> int:
    """Return the time that `text` names, as nanoseconds since the epoch.

    A time of day is on the recording's first day, unless only the next day puts it between
    `start_ns` and `end_ns`. The error names `option`.

    Raises:
        UsageError: The text is not a time.
    """
    if is_float(text):
        seconds = float(text)
        if math.isfinite(seconds) and 0 <= seconds <= MAX_SECONDS:
            return start_ns + round(seconds * NS_PER_S)
    else:
        first_day = datetime.fromtimestamp(start_ns // NS_PER_S, UTC).astimezone()
        same, next_ = (f"{first_day + timedelta(days=days):%Y-%m-%d}T{text}" for days in (0, 1))
        date_ns, same_ns, next_ns = map(_date_ns, (text, same, next_))
        if date_ns is not None:
            return date_ns
        if next_ns is not None and same_ns is not None:
            return next_ns if same_ns < start_ns and next_ns <= end_ns else same_ns
    raise UsageError(
        f"{option} {text} is not a time",
        "give seconds into the recording, a time such as 12:03:04, "
        "or a date such as 2026-01-01T12:03:04",
    )


def _date_ns(text: str) -> int | None:
    try:
        return round(datetime.fromisoformat(text).astimezone().timestamp() * NS_PER_S)
    except (ValueError, OverflowError, OSError):
        return None


def parse_since(text: str, now_ns: int) -> int:
    """Return the moment of `--since`, as nanoseconds since the epoch.

    Raises:
        UsageError: The text is neither a time span such as 30d, 12h or 15m, nor a date.
    """
    units_s = {"d": DAY_S, "h": 3_600.0, "m": 60.0, "s": 1.0}
    if text[-1:] in units_s and is_float(text[:-1]):
        span_s = float(text[:-1]) * units_s[text[-1]]
        if math.isfinite(span_s) and span_s >= 0:
            return max(now_ns - round(span_s * NS_PER_S), 0)
    date_ns = None if is_float(text) else _date_ns(text)
    if date_ns is None:
        raise UsageError(
            f"--since {text} is not a time", "give a span such as 30d, 12h or 15m, or 2026-01-31"
        )
    return date_ns
