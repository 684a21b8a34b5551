"""Notes of removals that no daemon made: the next one that tidies writes them into its journal."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import Final

from robotctl.recording.disk.access import open_private
from robotctl.recording.disk.atomic_output import replaced_file
from robotctl.recording.keep.tidy_note import TidyNote
from robotctl.regular_file import open_folder, open_regular

NOTES_FILE: Final = ".removed.jsonl"
"""In the folder of recordings."""

_MAX_BYTES: Final = 4 << 20
_APPEND: Final = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK


def note_removal(recordings: Path, path: Path, text: str) -> None:
    """Note that `path` is about to be removed; `text` says why.

    Raises:
        OSError: The note cannot be written.
    """
    with only_one_in(recordings):
        descriptor = open_private(recordings / NOTES_FILE, _APPEND)
        try:
            os.write(descriptor, json.dumps([str(path), text]).encode() + b"\n")
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def withdraw_note(recordings: Path, path: Path) -> None:
    """Drop the note of a file that was not removed after all.

    Raises:
        OSError: The notes cannot be written.
    """
    with only_one_in(recordings):
        notes = dict(_notes(recordings / NOTES_FILE))
        if notes.pop(str(path), None) is not None:
            _write(recordings / NOTES_FILE, notes)


def noted_removals(recordings: Path) -> Iterator[TidyNote]:
    """Yield each removal, and drop its note after that; the caller holds the lock of the folder.

    A note of a file that still exists stays: its removal is under way, or was interrupted.
    """
    path = recordings / NOTES_FILE
    notes = dict(_notes(path))
    if not notes:
        return
    for removed, text in notes.items():
        if not os.path.lexists(removed):
            yield TidyNote(f"{text}: {removed}", removed=removed)
    still = {removed: text for removed, text in notes.items() if os.path.lexists(removed)}
    with suppress(OSError):
        _write(path, still)


@contextmanager
def only_one_in(recordings: Path) -> Iterator[None]:
    """Wait until no other process tidies the folder, if its file system has such locks.

    Raises:
        OSError: The folder cannot be opened.
    """
    with open_folder(recordings) as folder:
        with suppress(OSError):  # NFS cannot lock a read-only descriptor
            flock(folder, LOCK_EX)
        yield


def _write(path: Path, notes: dict[str, str]) -> None:
    if not notes:
        path.unlink()
        return
    with replaced_file(path) as file:
        file.writelines(json.dumps(note).encode() + b"\n" for note in notes.items())


def _notes(path: Path) -> Iterator[tuple[str, str]]:
    try:
        with open_regular(path) as file:
            lines = file.read(_MAX_BYTES).splitlines()
    except OSError:
        return
    for line in lines:
        with suppress(ValueError, TypeError, RecursionError):  # torn, or of another program
            removed, text = json.loads(line)
            yield str(removed), str(text)
