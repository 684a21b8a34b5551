"""How much of the log may be written: at most 50 MB a year, whatever happens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, Final

from robotctl.decision_log.entries import DecisionKind, Entry
from robotctl.kernel.units import DAY_S

DAY_BYTES: Final = 130_000
"""With RESERVE_BYTES it is 50 MB a year: about 500 entries a day."""

RESERVE_BYTES: Final = 6_900
"""For the counts of what was not written, on each day."""

RESERVED: Final[dict[str, float]] = {
    DecisionKind.REQUEST: 0.5,
    DecisionKind.REFUSED: 0.5,
    DecisionKind.REMOVED: 0.5,
    DecisionKind.START: 0.25,
    DecisionKind.END: 0.25,
}
"""The part of a day's bytes that entries of a kind leave to others: a flood of requests, or a
daemon that crashes and starts again each second, must not crowd out the stops."""


class Budget:
    """The bytes that may be written now. They grow evenly to those of one day.

    Entries that do not fit are counted by kind, and one entry tells the counts.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        """`now_s` is a steady clock [s]."""
        self._now_s = now_s
        self._at_s = now_s()
        self._left: float = DAY_BYTES
        self._folded: Counter[str] = Counter()
        self._first_ns = self._last_ns = 0

    def grants(self, entry: Entry, size: int) -> bool:
        """Take `size` bytes for an entry, or return False: then `fold` it."""
        now_s = self._now_s()
        grown = self._left + (now_s - self._at_s) * DAY_BYTES / DAY_S
        self._left, self._at_s = min(grown, DAY_BYTES), now_s
        if self._left - size < DAY_BYTES * RESERVED.get(entry.kind, 0.0):
            return False
        self._left -= size
        return True

    def fold(self, entry: Entry, number: int = 1) -> None:
        """Count an entry that is not written, or a number of them."""
        if not self._folded:
            self._first_ns = entry.time_ns
        self._folded[entry.kind] += number
        self._last_ns = entry.time_ns

    def begin(self, used: int) -> None:
        """Begin with a day of which `used` bytes were written already."""
        self._left = max(DAY_BYTES - used, 0.0)

    @property
    def has_folded(self) -> bool:
        """Whether entries are counted that no entry has told yet."""
        return bool(self._folded)

    def counts(self) -> Entry:
        """Return the entry that tells the counts, and count from 0 again."""
        counts: dict[str, Any] = {str(kind): count for kind, count in self._folded.items()}
        values = {"counts": counts, "first_ns": self._first_ns, "last_ns": self._last_ns}
        self._folded.clear()
        return Entry(self._last_ns, DecisionKind.MORE, values)
