"""Puts journal entries in the order of their `seq`, and groups them into snapshots and steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import final

from robotctl.recording.format.journal import EntryKind, JournalEntry

MAX_DISORDER = 4096
"""How many entries are held back to put them in the order of their `seq`.

Our files are in order; those that another program sorted by time are not if the clock was set.
"""


@final
@dataclass(frozen=True, slots=True)
class Gap:
    """A place where journal entries are missing or out of order; `text` is a sentence about it."""

    text: str


class EntryOrder:
    """Holds back each entry until all entries with a lower `seq` have come, and orders them."""

    __slots__ = ("_accepted", "_first", "_following", "_held")

    def __init__(self) -> None:
        self._following = 0
        self._first: int | None = None
        self._held: list[tuple[int, int, JournalEntry]] = []
        self._accepted = 0

    def accept(self, entry: JournalEntry) -> Iterator[JournalEntry | Gap]:
        """Accept the next entry of the file; yield the entries that are now in order."""
        if self._first is None:
            self._first = self._following = entry.seq
        elif entry.seq < self._first:
            yield Gap(f"the journal is not in order: entry {entry.seq} follows {self._first}")
            self._first = entry.seq
            return
        self._accepted += 1
        heappush(self._held, (entry.seq, self._accepted, entry))
        yield from self._released(MAX_DISORDER)

    def rest(self) -> Iterator[JournalEntry | Gap]:
        """Yield the entries that are held back, at the end of the file."""
        yield from self._released(0)

    def _released(self, at_most: int) -> Iterator[JournalEntry | Gap]:
        held = self._held
        while held and (held[0][0] <= self._following or len(held) > at_most):
            seq, _, entry = heappop(held)
            if seq < self._following:
                yield Gap(f"the journal repeats entry {seq}")
                continue
            if seq > self._following:
                yield _missing(self._following, seq - 1)
            yield entry
            self._following = seq + 1


def in_sequence(entries: Iterable[JournalEntry]) -> Iterator[JournalEntry | Gap]:
    """Yield the entries ordered by `seq`, and the gaps and repetitions among them."""
    order = EntryOrder()
    for entry in entries:
        yield from order.accept(entry)
    yield from order.rest()


def _missing(first: int, last: int) -> Gap:
    if first == last:
        return Gap(f"the journal lacks entry {first}")
    return Gap(f"the journal lacks the entries {first} to {last}")


LogTimes = tuple[int, int]
"""When the last two events were recorded, in nanoseconds since the epoch."""

Moments = tuple[int, int, int]
"""When a step began, on the steady and on the wall clock, and ended, on the wall clock [ns]."""


@dataclass(slots=True)
class Step:
    """One event and the effects that were recorded after it."""

    event: JournalEntry
    effects: list[JournalEntry] = field(default_factory=list)
    cut: bool = False
    """Whether the journal ends or has a gap after it, so that effects may be missing."""


Item = Step | JournalEntry | Gap
"""A step, a snapshot, or a gap in the journal."""


def steps(entries: Iterable[JournalEntry]) -> Iterator[Item]:
    """Yield the steps, snapshots (as entries) and gaps of a journal; skip effects without event."""
    step: Step | None = None
    for entry in in_sequence(entries):
        if isinstance(entry, Gap):
            if step is not None:
                step.cut = True
                yield step
                step = None
            yield entry
        elif entry.kind is EntryKind.EFFECT:
            if step is not None:
                step.effects.append(entry)
        else:
            if step is not None:
                yield step
                step = None
            if entry.kind is EntryKind.EVENT:
                step = Step(entry)
            else:
                yield entry
    if step is not None:
        step.cut = True
        yield step
