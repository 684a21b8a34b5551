"""Groups journal entries into snapshots, and steps of one event with its effects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.entry_order import Gap, in_sequence

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


Item = Step | JournalEntry | Gap
"""A step, a snapshot, or a gap in the journal."""


def steps(entries: Iterable[JournalEntry]) -> Iterator[Item]:
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
