"""Finds what a journal entry of another version says and this version has no name for."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.journal_values import read_effect, read_event, read_snapshot

MAX_FORMS = 4096
MAX_FORM_BYTES = 1000
"""A form is an entry's text without its digits. Forms are kept so that each is looked at once; a
request holds any text, and a file must not fill the memory with it."""

_READERS = {
    EntryKind.EVENT: read_event,
    EntryKind.EFFECT: read_effect,
    EntryKind.SNAPSHOT: read_snapshot,
}


class Vocabulary:
    """Remembers the forms of text in which all fields are known."""

    def __init__(self) -> None:
        self._known: set[tuple[str, bytes]] = set()

    def unknown_field(self, entry: JournalEntry) -> str:
        """Return the first field that this version would pass over, as `Name.path`, or "".

        Raises UnreadableFile where the entry as a whole is none of this version.
        """
        form = (entry.name, entry.data.encode().translate(None, b"0123456789"))
        if form in self._known:
            return ""
        ours = json.loads(to_json(_READERS[entry.kind](entry)))
        try:
            unknown = next(_added(entry.name, json.loads(entry.data), ours), "")
        except RecursionError:
            raise UnreadableFile(f"journal entry {entry.seq} is nested too deeply") from None
        if not unknown and len(form[1]) <= MAX_FORM_BYTES and len(self._known) < MAX_FORMS:
            self._known.add(form)
        return unknown


def _added(path: str, theirs: Any, ours: Any) -> Iterator[str]:
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for name, value in theirs.items():
            if name in ours:
                yield from _added(f"{path}.{name}", value, ours[name])
            else:
                yield f"{path}.{name[:40]}"
    elif isinstance(theirs, list) and isinstance(ours, list):
        for each, own in zip(theirs, ours, strict=False):
            yield from _added(f"{path}[]", each, own)
