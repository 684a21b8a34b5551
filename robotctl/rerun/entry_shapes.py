"""Whether the text of an event is as it was written, told by its shape: the text without digits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from robotctl.kernel.types import Event
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.comparison import Comparison

MAX_SHAPES = 4096
"""The number of entry shapes that are remembered: a source may be any text."""


class EntryShapes:
    """The shapes of the texts that were correct; in another version each text counts as such."""

    def __init__(self, comparison: Comparison) -> None:
        self._comparison = comparison
        self._known: set[bytes] = set()

    def are_untouched(self, entries: Sequence[JournalEntry], events: Sequence[Event]) -> bool:
        """Return whether all entries are as `is_untouched` says."""
        shapes = _shapes(entries)
        unknown = set(shapes) - self._known
        return len(shapes) == len(entries) and all(
            self.is_untouched(entry, event)
            for shape, entry, event in zip(shapes, entries, events, strict=True)
            if shape in unknown
        )

    def is_untouched(self, entry: JournalEntry, event: Event) -> bool:
        """Return whether the entry is unchanged since it was written for this event.

        The text without its digits is compared with texts that were correct; the digits are the
        values of the event.
        """
        if not self._comparison.same_version:
            return True
        shape = _shape(entry)
        if shape not in self._known:
            if not self._comparison.same(entry.data, event):
                return False
            if len(self._known) < MAX_SHAPES:
                self._known.add(shape)
        return entry.t_ns == event.t_ns


def _shape(entry: JournalEntry) -> bytes:
    """Return the text of an entry without its digits."""
    return entry.data.encode().translate(None, b"0123456789")


def _shapes(events: Iterable[JournalEntry]) -> list[bytes]:
    """Return the shape of each event, or more shapes if a text holds a line break."""
    texts = "\n".join([entry.data for entry in events])
    return texts.encode().translate(None, b"0123456789").split(b"\n")
