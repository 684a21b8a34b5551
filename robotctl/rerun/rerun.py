"""Re-runs a recorded journal through a new kernel and compares its decisions bit for bit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.state import State
from robotctl.kernel.types import Decision, Effect, Event
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.comparison import DECISION_NAMES, Comparison
from robotctl.rerun.divergence import Divergence
from robotctl.rerun.entry_order import Gap
from robotctl.rerun.journal_steps import Step, steps
from robotctl.rerun.journal_values import (
    KERNEL_FAILURES,
    read_event,
    read_snapshot,
    text_of,
)


class Decided(NamedTuple):
    """The result of one step; `effects` is None without a kernel and after a divergence."""

    event: Event
    effects: tuple[Effect, ...] | None = None
    divergence: Divergence | None = None


class Rerun:
    """A new kernel that takes the recorded events from the first snapshot on.

    After a divergence and after `stop` it waits for the next snapshot; `kernel` is None meanwhile.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        self.kernel: Kernel | None = None
        self._event: JournalEntry | None = None
        self._same_version = comparison.same_version

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self.kernel = None

    def snapshot(self, entry: JournalEntry) -> tuple[Snapshot, Divergence | None]:
        """Continue from a recorded snapshot; return it, and how the kernel differs from it.

        Raises:
            UnreadableFile: The entry is not a snapshot of this version.
        """
        snapshot = read_snapshot(entry)
        kernel, self.kernel, self._event = self.kernel, snapshot.kernel(), None
        mine = replace(snapshot, params=kernel.params, state=kernel.state) if kernel else snapshot
        if self.comparison.same(entry.data, mine):
            return snapshot, None  # compared as texts, because nan is not equal to nan
        if not self._same_version and mine.params == snapshot.params:
            return snapshot, None  # parameters change by events alone, in every version
        before = kernel.state if kernel else None
        return snapshot, self._divergence(entry, mine, before)

    def step(self, step: Step) -> Decided:
        """Decide on the event of a step again, and compare the effects.

        Raises:
            UnreadableFile: The event is not one of this version.
        """
        entry, kernel = step.event, self.kernel
        event = read_event(entry)
        if kernel is None:
            return Decided(event)
        self._event = entry
        before = kernel.state
        if not self._is_untouched(entry, event):
            return self._diverged(event, entry, event, before)
        theirs = step.effects
        try:
            decided = mine = kernel.step(event)
        except KERNEL_FAILURES as error:
            found = self._divergence(theirs[0] if theirs else None, None, before)
            self.kernel = None
            return Decided(event, None, replace(found, decided=f"{type(error).__name__} {error}"))
        if not self._same_version:
            theirs = [effect for effect in theirs if effect.name in DECISION_NAMES]
            mine = tuple(effect for effect in mine if isinstance(effect, Decision))
        for recorded, effect in zip(theirs, mine, strict=False):
            if not self._is_recorded(effect, recorded, entry.t_ns):
                return self._diverged(event, recorded, effect, before)
        if len(theirs) > len(mine):
            return self._diverged(event, theirs[len(mine)], None, before)
        if len(theirs) < len(mine) and not step.cut:
            return self._diverged(event, None, mine[len(theirs)], before)
        return Decided(event, decided)

    def _is_untouched(self, entry: JournalEntry, event: Event) -> bool:
        """Return whether an entry is as it was written; in another version each counts as such."""
        return not self._same_version or (
            entry.t_ns == event.t_ns and self.comparison.same(entry.data, event)
        )

    def _is_recorded(self, effect: Effect, recorded: JournalEntry, t_ns: int) -> bool:
        return (
            recorded.t_ns == t_ns
            and recorded.name == type(effect).__name__
            and self.comparison.same(recorded.data, effect)
        )

    def _diverged(
        self, event: Event, recorded: JournalEntry | None, mine: Any, before: State
    ) -> Decided:
        self.kernel = None
        return Decided(event, None, self._divergence(recorded, mine, before))

    def _divergence(
        self, recorded: JournalEntry | None, mine: Any, before: State | None
    ) -> Divergence:
        """Describe the difference between a recorded entry and a decision; one may be missing."""
        at = recorded or self._event
        assert at is not None
        differences: list[str] = []
        if recorded is not None and mine is not None and recorded.name == type(mine).__name__:
            differences = self.comparison.differences(recorded.data, to_json(mine))
        return Divergence(
            seq=at.seq,
            t_ns=at.t_ns,
            event="" if self._event is None else _text(self._event),
            recorded="" if recorded is None else _text(recorded),
            decided="" if mine is None else text_of(mine),
            before=before,
            differences=tuple(differences),
        )


def first_divergence(entries: Iterable[JournalEntry]) -> Divergence | None:
    """Return the first divergence of a new kernel from the journal, None if there is none.

    Entries before the first snapshot are skipped. Effects of the last event may be missing, as
    after a kill.

    Raises:
        UnreadableFile: Entries are missing or are not of this version.
    """
    again = Rerun(Comparison())
    for item in steps(entries):
        if isinstance(item, Gap):
            raise UnreadableFile(item.text)
        if isinstance(item, Step):
            found = again.step(item).divergence if again.kernel is not None else None
        else:
            _, found = again.snapshot(item)
        if found is not None:
            return found
    return None


def _text(entry: JournalEntry) -> str:
    return f"{entry.name} {entry.data}"
