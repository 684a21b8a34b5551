"""Remove a recording that the user names, after a question."""

from __future__ import annotations

import sys
from pathlib import Path

from robotctl.cli.terminal.text import printable, size
from robotctl.errors import IN_PARENTHESES, Interrupted, Refused, UsageError


def remove(path: Path, *, without_asking: bool) -> int:
    """Remove the recording in the folder `path`, and return how many bytes that were.

    Raises:
        Refused: It is no recording of robotctl, is being written, is kept, or cannot be removed.
        UsageError: There is no terminal to ask on.
        Interrupted: The user said no.
    """
    from robotctl.recording.keep.catalog import own_recording
    from robotctl.recording.keep.retention import remove_recording

    try:
        recording = own_recording(path)
    except OSError as error:
        raise Refused(f"{path} cannot be read: {error.strerror}") from error
    if recording is None:
        raise Refused(
            f"{path} is not the folder of a recording of robotctl",
            "see: robotctl recordings",
            sentence=IN_PARENTHESES,
        )
    if recording.live:
        raise Refused(f"{path} is being recorded", "first: robotctl stop", sentence=IN_PARENTHESES)
    if recording.kept:
        raise Refused(
            f"{path} is kept",
            f"first: robotctl recordings unkeep {path.name}",
            sentence=IN_PARENTHESES,
        )
    total = sum(file.size for file in (*recording.files, *recording.clips))
    if not without_asking:
        _ask(f"remove {printable(str(path))} ({size(total)})?")
    try:
        return sum(each.size for each in remove_recording(recording))
    except OSError as error:
        raise Refused(f"{error.filename} cannot be removed: {error.strerror}") from error


def _ask(question: str) -> None:
    if not sys.stdin.isatty():
        raise UsageError("there is no terminal to ask on", "give --yes", sentence=IN_PARENTHESES)
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise Interrupted("nothing was removed")
