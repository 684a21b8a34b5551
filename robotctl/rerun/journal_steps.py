"""Groups journal entries into snapshots, and steps of one event with its effects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush

from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.read.messages import Message

MAX_DISORDER = 4096
"""How many entries are held back to put them in the order of their `seq`.

Our files are in order; in a file that another program sorted by time, entries are out of order
around a change of the clock.
"""


LogTimes = tuple[int, int]
"""When the last two events were recorded, in nanoseconds since the epoch."""

Moments = tuple[int, int, int]
"""The begin of a step by steady clock and wall clock, and its end by the wall clock [ns]."""


@dataclass(slots=True)
class Step:
    """One event and the effects that were recorded after it."""

    event: JournalEntry
    effects: list[JournalEntry] = field(default_factory=list)
    cut: bool = False
    """Whether the journal ends after it, so that effects may be missing."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A place where journal entries are missing or out of order; `text` says which."""

    text: str


Item = Step | Message | JournalEntry | Gap
"""A step, a message of a compared topic, a snapshot, or a gap in the journal."""


def steps(entries: Iterable[JournalEntry]) -> Iterator[Step | JournalEntry | Gap]:
    """Yield the steps, the snapshots (as entries) and the gaps of a journal.

    Effects whose event is missing are skipped.
    """
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


def in_sequence(entries: Iterable[JournalEntry]) -> Iterator[JournalEntry | Gap]:
    """Yield the entries ordered by `seq`, and the gaps and repetitions among them."""
    held: list[tuple[int, int, JournalEntry]] = []
    first: int | None = None
    following = 0

    def take_held(at_most: int) -> Iterator[JournalEntry | Gap]:
        nonlocal following
        while held and (held[0][0] <= following or len(held) > at_most):
            seq, _, entry = heappop(held)
            if seq < following:
                yield Gap(f"the journal repeats entry {seq}")
                continue
            if seq > following:
                yield _missing(following, seq - 1)
            yield entry
            following = seq + 1

    for position, entry in enumerate(entries):
        if entry.seq == following and not held and first is not None:
            yield entry
            following += 1
            continue
        if first is None:
            first = following = entry.seq
        elif entry.seq < first:
            yield Gap(f"the journal is not in order: entry {entry.seq} follows {first}")
            first = entry.seq
            continue
        heappush(held, (entry.seq, position, entry))
        yield from take_held(MAX_DISORDER)
    yield from take_held(0)


def _missing(first: int, last: int) -> Gap:
    if first == last:
        return Gap(f"the journal lacks entry {first}")
    return Gap(f"the journal lacks the entries {first} to {last}")
