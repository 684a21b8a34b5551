"""Find the recordings among given files: for --check, --what-if, --resim and `verify`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from robotctl.cli.targets.recordings import find_recording
from robotctl.cli.ui.text import short_path
from robotctl.recording.read.files import is_bag, is_recording

LABEL_WIDTH = 12
"""Width of the column before a path: a verdict or `skipped`."""


def select_recordings(
    files: Sequence[Path], robot: str | None, *, also_urls: bool = False
) -> tuple[list[Path], list[Path]]:
    """Return the recordings that `files` name (paths, names or `last`), and the paths to skip.

    A folder of recordings stands for all recordings in it. If no path is a recording, no path is
    skipped: the caller reads each path, and gets an error that says why it is not a recording.

    Raises:
        Refused: `last` was given and there is no recording.
        UsageError: A URL was given, but not `also_urls`.
    """
    found = [find_recording(str(file), robot, also_url=also_urls) for file in files]
    skipped = [path for path in found if not is_recording(path)]
    if len(skipped) == len(found):
        skipped = []
    return [each for path in found if path not in skipped for each in _recordings_at(path)], skipped


def skipped_lines(skipped: Sequence[Path]) -> list[str]:
    """Return a line for each path that is not a recording."""
    return [f"{'skipped':{LABEL_WIDTH}}{short_path(path)}: not a recording" for path in skipped]


def _recordings_at(path: Path) -> list[Path]:
    """Return the recording at `path`, or those in it if it is a folder of recordings."""
    try:
        if path.is_dir() and not is_bag(path):
            return sorted(filter(is_bag, path.iterdir())) or [path]
    except OSError:
        pass  # the reader of the recording reports why
    return [path]
