"""Recordings of drives that a test changes and checks."""

from __future__ import annotations

import re
from pathlib import Path

from robotctl import __version__
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, encode
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report
from robotctl.testing.drives import (
    Written,
    record,
)


def checked(folder: Path, written: list[Written], version: str = __version__) -> Report:
    return check_recording(record(folder / "run", written, version=version))


def rechained(written: list[Written]) -> list[Written]:
    """Return the journal with the CRC of each snapshot computed anew."""
    again: list[Written] = []
    crc: int | None = None
    for each in written:
        entry = each
        if isinstance(entry, JournalEntry):
            if entry.kind is EntryKind.SNAPSHOT:
                crc = _proof_of(entry) if crc is None else crc
                text = re.sub(r'"journal_crc":[0-9]+', f'"journal_crc":{crc}', entry.data)
                entry = entry._replace(data=text)
            crc = None if crc is None else chained(encode(entry), crc)
        again.append(entry)
    return again


def _proof_of(snapshot: JournalEntry) -> int | None:
    found = re.search(r'"journal_crc":([0-9]+)', snapshot.data)
    return int(found[1]) if found else None


def altered(written: list[Written], name: str, old: str, new: str) -> tuple[list[Written], int]:
    """Return the journal with the last entry of that name changed, and its number."""
    changed = list(written)
    for position in range(len(changed) - 1, -1, -1):
        each = changed[position]
        if isinstance(each, JournalEntry) and each.name == name and old in each.data:
            changed[position] = each._replace(data=each.data.replace(old, new, 1))
            return rechained(changed), each.seq
    raise AssertionError(f"no {name} holds {old}")
