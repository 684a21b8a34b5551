"""The counters of the loss ledger; this is the only list of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Final


@dataclass(slots=True)
class MessageCounts:
    """What happened to messages: received = written + queued + dropped.

    Not frozen: `status` makes one object for each topic in the loop, and frozen ones take three
    times as long.
    """

    received: int = 0
    written: int = 0
    queued: int = 0
    dropped: int = 0
    lost: int = 0
    """Sent between two messages that were received: gaps in a publisher's sequence numbers."""

    unseen: int = 0
    """Sent by a publisher before its first message that was received."""

    not_repeated: int = 0
    """Latched messages that later files do not repeat, for lack of memory or room in the file."""

    throttled: int = 0
    """Left out before the recorder received them: throttled, or because the disk is full soon."""


COUNTERS: Final = tuple(field.name for field in fields(MessageCounts))

_values = attrgetter(*COUNTERS)


def total(counts: Iterable[MessageCounts]) -> dict[str, int]:
    """Return the sum of each counter, by name."""
    sums = map(sum, zip(*map(_values, counts), strict=True))
    return dict(zip(COUNTERS, sums, strict=False)) or dict.fromkeys(COUNTERS, 0)


class RunningTotal:
    """The sum of counts of which most are the same objects as at the last sum."""

    def __init__(self) -> None:
        self._counts: Sequence[MessageCounts] = ()
        self._sums = dict.fromkeys(COUNTERS, 0)

    def of(self, counts: Sequence[MessageCounts]) -> dict[str, int]:
        """Return the sum of each counter, by name, as `total` does."""
        before, self._counts = self._counts, counts
        if counts is before:
            return self._sums
        changes = [(old, new) for old, new in zip(before, counts, strict=False) if old is not new]
        if len(counts) != len(before) or 2 * len(changes) > len(counts):
            self._sums = total(counts)
        elif changes:
            gone, come = (total(side) for side in zip(*changes, strict=True))
            self._sums = {name: self._sums[name] - gone[name] + come[name] for name in COUNTERS}
        return self._sums
