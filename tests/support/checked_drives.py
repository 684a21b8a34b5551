"""Recordings of drives that a test changes and checks."""

from __future__ import annotations

from pathlib import Path

from robotctl import __version__
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report
from robotctl.testing.drives import (
    Written,
    record,
)


def checked(folder: Path, written: list[Written], version: str = __version__) -> Report:
    return check_recording(record(folder / "run", written, version=version))


def altered(written: list[Written], name: str, old: str, new: str) -> tuple[list[Written], int]:
    """Return the journal with the last entry of that name changed, and its number."""
    changed = list(written)
    for position in range(len(changed) - 1, -1, -1):
        each = changed[position]
        if isinstance(each, JournalEntry) and each.name == name and old in each.data:
            changed[position] = each._replace(data=each.data.replace(old, new, 1))
            return changed, each.seq
    raise AssertionError(f"no {name} holds {old}")
