"""Tells a journal of another version from one of this version that was changed, by its fields."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from robotctl.kernel.codec import to_json
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.check_report import Report
from robotctl.rerun.journal_values import read_snapshot
from robotctl.rerun.unknown_fields import Vocabulary


class JournalFormat:
    """The comparison of the fields of a journal with those of this version."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._vocabulary: Vocabulary | None = Vocabulary()

    def begin(self, entry: JournalEntry) -> None:
        """Look for fields of another version in the first snapshot.

        Raises:
            UnreadableFile: The entry is not a snapshot of this version.
        """
        report = self._report
        if report.same_version and (field := other_field(entry)):
            report.has_other_format = True
            report.miss(
                f"written by another version that calls itself {report.version}: its state {field}"
            )

    def compare(self, *entries: JournalEntry) -> None:
        """Report the first field of another version that this version does not know.

        Raises:
            UnreadableFile: An entry is not of this version.
        """
        if self._vocabulary is None or self._report.same_version:
            return
        for entry in entries:
            if field := self._vocabulary.unknown_field(entry):
                self._report.miss_other_rules(f"entry {entry.seq}: {field!r} is not known")
                self._vocabulary = None
                return


def other_field(entry: JournalEntry) -> str:
    """Return how the fields of a snapshot differ from those of this version, "" if they do not.

    Raises:
        UnreadableFile: The entry is not a snapshot of this version.
    """
    ours = json.loads(to_json(read_snapshot(entry)))
    return next(_differing("", json.loads(entry.data), ours), "")


def _differing(path: str, theirs: Any, ours: Any) -> Iterator[str]:
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for name in ours:
            if name not in theirs:
                yield f"lacks {path}{name}"
        for name, value in theirs.items():
            if name not in ours:
                yield f"has {path}{name[:40]}"
            else:
                yield from _differing(f"{path}{name}.", value, ours[name])
    elif isinstance(theirs, list) and isinstance(ours, list):
        for each, own in zip(theirs, ours, strict=False):
            yield from _differing(path, each, own)
