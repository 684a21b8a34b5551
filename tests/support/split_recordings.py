"""Recordings of two files, made of one: the second file begins with a later snapshot."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from robotctl.recording.format.journal import EntryKind, decode
from robotctl.recording.format.metadata_names import LEDGER_RECORD
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import JOURNAL


def halves(contents: Contents, *, queued: int = 0) -> tuple[Contents, Contents]:
    """Return what two files hold.

    The ledger of the first one may count journal entries that were `queued` for the second.
    """
    at = [
        number
        for number, each in enumerate(contents.messages)
        if each.topic == JOURNAL and decode(each.data).kind is EntryKind.SNAPSHOT
    ][1]
    first, second = contents.copy(), contents.copy()
    first.messages, second.messages = contents.messages[:at], contents.messages[at:]
    second.counts = Counter(each.topic for each in second.messages)  # its ledger counts both files
    for name, values in first.metadata:
        if name == LEDGER_RECORD:
            counts = json.loads(values[JOURNAL])
            counts |= {"received": counts["received"] + queued, "queued": queued}
            values[JOURNAL] = json.dumps(counts)
    return first, second


def write_files(folder: Path, *parts: Contents) -> Path:
    """Write files of one recording into a new folder, and return the folder."""
    folder.mkdir(parents=True)
    for number, part in enumerate(parts):
        (file,) = write_contents(folder.parent / f"part{number}", part).glob("*.mcap")
        file.rename(folder / f"{folder.name}_{number}.mcap")
        file.parent.rmdir()
    return folder
