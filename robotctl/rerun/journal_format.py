"""Distinguishes a journal of another version from a changed one of this version, by its fields."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from robotctl.base import retired
from robotctl.base.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.check_report import Report
from robotctl.rerun.journal import read_effect, read_event, read_snapshot

MAX_FORMS = 4096
MAX_FORM_BYTES = 1000
"""A form is the text of an entry without its digits; each form is parsed only once.

Both limits bound the memory of the stored forms: a request may contain any text.
"""

_READERS = {
    EntryKind.EVENT: read_event,
    EntryKind.EFFECT: read_effect,
    EntryKind.SNAPSHOT: read_snapshot,
}


def without_retired_fields(entry: JournalEntry) -> JournalEntry:
    """Return the entry without the retired fields that have their default."""
    names = {
        path.partition(".")[2]: default
        for path, default in retired.JOURNAL_FIELDS.items()
        if path.startswith(f"{entry.name}.") and f'"{path.rpartition(".")[2]}":' in entry.data
    }
    if not names:
        return entry
    try:
        data = json.loads(entry.data)
    except (ValueError, RecursionError):
        return entry
    for path, default in names.items():
        *sections, name = path.split(".")
        section = data
        for each in sections:
            section = section.get(each) if isinstance(section, dict) else None
        if isinstance(section, dict) and section.get(name) == default:
            section.pop(name, None)
    # As the journal is written: a float reads back to the same bits.
    return entry._replace(data=json.dumps(data, separators=(",", ":")))


class Vocabulary:
    """Finds unknown fields in entries; parses only the first of all entries with the same form."""

    def __init__(self) -> None:
        self._known: set[tuple[str, bytes]] = set()

    def unknown_field(self, entry: JournalEntry) -> str:
        """Return the first field that this version would ignore, as `Name.path`, or "".

        Raises:
            UnreadableFile: The whole entry is not of this version.
        """
        form = (entry.name, entry.data.encode().translate(None, b"0123456789"))
        if form in self._known:
            return ""
        ours = json.loads(to_json(_READERS[entry.kind](entry)))
        try:
            differing = _differing("", json.loads(entry.data), ours)
            unknown = next((f"{entry.name}.{name}" for is_new, name in differing if is_new), "")
        except RecursionError:
            raise UnreadableFile(f"journal entry {entry.seq} is nested too deeply") from None
        if not unknown and len(form[1]) <= MAX_FORM_BYTES and len(self._known) < MAX_FORMS:
            self._known.add(form)
        return unknown


class JournalFormat:
    """Compares the fields of a journal with those of this version."""

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
    differing = _differing("", json.loads(entry.data), ours)
    return next((f"{'has' if is_new else 'lacks'} {name}" for is_new, name in differing), "")


def _differing(path: str, theirs: Any, ours: Any) -> Iterator[tuple[bool, str]]:
    """Yield the path of each field that only one side has, and whether only theirs has it."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for name in ours:
            if name not in theirs:
                yield False, f"{path}{name}"
        for name, value in theirs.items():
            if name not in ours:
                yield True, f"{path}{name[:40]}"
            else:
                yield from _differing(f"{path}{name}.", value, ours[name])
    elif isinstance(theirs, list) and isinstance(ours, list):
        for each, own in zip(theirs, ours, strict=False):
            yield from _differing(f"{path.removesuffix('.')}[].", each, own)
