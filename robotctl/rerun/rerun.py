"""Re-runs a recorded journal through a new kernel and compares its decisions bit for bit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, repeat
from typing import Any, NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.state import State
from robotctl.kernel.types import Decision, Effect, Event
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.agreed import Agreed, followed_steps, new_tuple, read_events
from robotctl.rerun.comparison import DECISION_NAMES, Comparison
from robotctl.rerun.divergence import Divergence
from robotctl.rerun.entry_order import Gap
from robotctl.rerun.entry_shapes import EntryShapes
from robotctl.rerun.journal_steps import LogTimes, Step, steps
from robotctl.rerun.journal_values import (
    KERNEL_FAILURES,
    read_effect,
    read_event,
    read_snapshot,
    text_of,
)
from robotctl.rerun.measured import Followed, MeasuredState


class ConfirmedPiece(NamedTuple):
    """A piece of a journal, from a snapshot to the next, that a kernel decides as it is recorded.

    `unused` are the numbers of the entries whose odometry the kernel did not take as new.
    """

    unused: frozenset[int]


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
        self._followed: Followed | None = None
        """Set while the steps are those that were re-run elsewhere."""

        self._event: JournalEntry | None = None
        self._same_version = comparison.same_version
        self._shapes = EntryShapes(comparison)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._set_kernel(None)

    def trust(self, piece: ConfirmedPiece | None) -> None:
        """Take the recorded steps of a piece, and the snapshot that ends it, as decided."""
        if piece is not None and self.kernel is not None:
            kernel = self.kernel
            scale = kernel.params.battery.scale
            self._followed = Followed(kernel.state.health, scale, piece.unused)

    @property
    def is_trusting(self) -> bool:
        """Whether the present steps were re-run elsewhere."""
        return self._followed is not None

    @property
    def measured(self) -> MeasuredState | None:
        """What is measured after the last step; None without a kernel."""
        if self._followed is not None:
            return self._followed.measured
        return None if self.kernel is None else self.kernel.state.health

    def _set_kernel(self, kernel: Kernel | None) -> None:
        self.kernel = kernel
        self._followed = None

    def snapshot(self, entry: JournalEntry) -> tuple[Snapshot, Divergence | None]:
        """Continue from a recorded snapshot; return it, and how the kernel differs from it.

        Raises:
            UnreadableFile: The entry is not a snapshot of this version.
        """
        snapshot = read_snapshot(entry)
        kernel, was_trusting = self.kernel, self.is_trusting
        self._set_kernel(snapshot.kernel())
        if was_trusting:
            return snapshot, None
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
        if self._followed is not None:
            self._followed.step(entry.seq, event)
            return Decided(event, tuple(map(read_effect, step.effects)))
        self._event = entry
        before = kernel.state
        if not self._shapes.is_untouched(entry, event):
            return self._diverged(event, entry, event, before)
        theirs = step.effects
        try:
            decided = mine = kernel.step(event)
        except KERNEL_FAILURES as error:
            found = self._divergence(theirs[0] if theirs else None, None, before)
            self._set_kernel(None)
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

    def ahead(
        self, steps: Sequence[Step], log_times: Iterable[LogTimes] = repeat((0, 0))
    ) -> list[Agreed]:
        """Decide on many steps at once, and return those before the first that `step` must take.

        `log_times` are those of each step. One kind of work after the other takes a fifth less
        time than step by step.
        """
        kernel = self.kernel
        if kernel is None or not self._same_version:
            return []
        if self._followed is not None:
            return followed_steps(self._followed, steps, log_times)
        before = kernel.params, kernel.state
        events = read_events(steps)
        agreed: list[Agreed] = []
        with suppress(*KERNEL_FAILURES):
            for step, event, times in zip(steps, events, log_times, strict=False):
                effects = kernel.step(event)
                agreed.append(
                    new_tuple(Agreed, (step.event.seq, event, effects, kernel.state.health, times))
                )
        count = self._agreeing(steps, agreed)
        if count < len(steps):
            del agreed[count:]
            kernel.params, kernel.state = before
            for each in agreed:
                kernel.step(each.event)
        return agreed

    def _agreeing(self, steps: Sequence[Step], decided: Sequence[Agreed]) -> int:
        """Return how many steps were recorded as they were decided, before the first other one."""
        if self._all_agree(steps[: len(decided)], decided):
            return len(decided)
        for number, (step, mine) in enumerate(zip(steps, decided, strict=False)):
            entry, theirs, effects = step.event, step.effects, mine.effects
            if len(theirs) != len(effects) or not self._shapes.is_untouched(entry, mine.event):
                return number
            for recorded, effect in zip(theirs, effects, strict=True):
                if not self._is_recorded(effect, recorded, entry.t_ns):
                    return number
        return len(decided)

    def _all_agree(self, steps: Sequence[Step], decided: Sequence[Agreed]) -> bool:
        """Return whether many steps were recorded as they were decided."""
        entries, events = [step.event for step in steps], [each.event for each in decided]
        theirs, mine = [step.effects for step in steps], [each.effects for each in decided]
        if not (
            [entry.t_ns for entry in entries] == [event.t_ns for event in events]
            and [*map(len, theirs)] == [*map(len, mine)]
        ):
            return False
        recorded, effects = [*chain.from_iterable(theirs)], [*chain.from_iterable(mine)]
        times_ns = [step.event.t_ns for step in steps for _ in step.effects]
        return (
            [entry.t_ns for entry in recorded] == times_ns
            and [entry.name for entry in recorded] == [type(each).__name__ for each in effects]
            and all(map(self.comparison.same, [entry.data for entry in recorded], effects))
            and self._shapes.are_untouched(entries, events)
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
        self._set_kernel(None)
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
