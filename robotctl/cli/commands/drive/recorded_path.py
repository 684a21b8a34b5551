"""The path that a recorded robot drove, to drive it again."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

from robotctl.cli.support.last_recordings import committed_recording, with_earlier
from robotctl.cli.support.recording_paths import LAST, find_recording
from robotctl.cli.terminal.text import printable, short_path
from robotctl.errors import UnreadableFile
from robotctl.kernel.course import Frame, Point
from robotctl.rerun.driven_path import driven_path


def last_path(robot: str, frame: Frame) -> tuple[Point, ...]:
    """Return the path of the newest recording in which the robot drove; a note names an older one.

    A running daemon first writes what it has not written yet.

    Raises:
        Refused: The robot has no recording.
        UnreadableFile: It drove in none of the last ones, or one cannot be read.
    """
    missing: list[str] = []
    newest = committed_recording(robot, missing) or find_recording(LAST, robot)
    for sentence in missing:
        _note(newest, sentence)
    paths = with_earlier(newest)
    for path in paths:
        points = driven_path(path, frame, partial(_note, path))
        if points:
            if path != newest:
                _note(path, "the newest recording in which the robot drove")
            return points
    before = f" and {len(paths) - 1} before it" if len(paths) > 1 else ""
    raise UnreadableFile(f"{newest}{before}: the robot did not drive")


def recorded_path(recording: Path, frame: Frame) -> tuple[Point, ...]:
    """Return the path of a recording.

    Raises:
        UnreadableFile: The recording cannot be read, its robot did not drive, or a part of its last
            motion is missing.
    """
    points = driven_path(recording, frame, partial(_note, recording))
    if not points:
        raise UnreadableFile(f"{recording} holds no path: its robot did not drive")
    return points


def _note(path: Path, sentence: str) -> None:
    print(f"note: {printable(short_path(path))}: {printable(sentence)}", file=sys.stderr)
