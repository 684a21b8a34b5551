"""A recorded journal decided once more by a fresh kernel: does it decide the same, bit for bit?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel, State
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import Effect, Event
from robotctl.recording.journal import JournalEntry
from robotctl.replay.comparison import Comparison
from robotctl.replay.steps import Gap, Step, steps
from robotctl.replay.values import read_event, read_snapshot, text_of


@dataclass(frozen=True, slots=True)
class Divergence:
    """Where a fresh kernel decided differently, as texts `Name {json}`; "" where one is missing.

    `seq` and `t_ns` are those of the recorded entry at which it shows, `event` is what both
    kernels had to decide on, `before` what the fresh one remembered then; `differences` name
    the fields.
    """

    seq: int
    t_ns: int
    event: str
    recorded: str
    decided: str
    before: State | None
    differences: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Decided:
    """A step decided again; `effects` are None where there is nothing to compare them with."""

    event: Event
    effects: tuple[Effect, ...] | None = None
    divergence: Divergence | None = None


class Rerun:
    """A fresh kernel that gets the recorded events, from the first snapshot on.

    After a divergence, and after `stop`, it waits for the next snapshot: `kernel` is None then.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        self.kernel: Kernel | None = None
        self._event = ""

    def stop(self) -> None:
        """Events are missing from here on."""
        self.kernel = None

    def snapshot(self, entry: JournalEntry) -> tuple[Snapshot, Divergence | None]:
        """Go on from here; says what the kernel so far remembers differently.

        Raises UnreadableFile where the entry is not one of this version.
        """
        snapshot = read_snapshot(entry)
        kernel, self.kernel = self.kernel, snapshot.kernel()
        mine = Snapshot(snapshot.made_by, kernel.params, kernel.state) if kernel else snapshot
        if not self.comparison.same_version or self.comparison.same(entry.data, mine):
            return snapshot, None  # as texts, for no nan equals another
        before = kernel.state if kernel else None
        return snapshot, self._divergence(self._event, entry, mine, before)

    def step(self, step: Step) -> Decided:
        """Decide on the step's event again. Raises UnreadableFile where the entry is not ours."""
        entry, kernel = step.event, self.kernel
        event = read_event(entry)
        if kernel is None:
            return Decided(event)
        self._event = _text(entry)
        before = kernel.state
        if not self._is_untouched(entry, event):
            return self._stop(event, self._divergence(self._event, entry, event, before))
        decided = kernel.step(event)
        mine = [effect for effect in decided if self._compares(type(effect).__name__)]
        theirs = [effect for effect in step.effects if self._compares(effect.name)]
        for recorded, effect in zip(theirs, mine, strict=False):
            if (
                recorded.name != type(effect).__name__
                or recorded.t_ns != entry.t_ns
                or not self.comparison.same(recorded.data, effect)
            ):
                found = self._divergence(self._event, recorded, effect, before)
                return self._stop(event, found)
        if len(theirs) > len(mine):
            found = self._divergence(self._event, theirs[len(mine)], None, before)
            return self._stop(event, found)
        if len(mine) > len(theirs) and not step.cut:
            text = text_of(mine[len(theirs)])
            at = theirs[-1] if theirs else entry
            return self._stop(event, Divergence(at.seq, at.t_ns, self._event, "", text, before))
        return Decided(event, decided)

    def _compares(self, name: str) -> bool:
        return self.comparison.compares(name)

    def _is_untouched(self, entry: JournalEntry, event: Event) -> bool:
        """Whether the entry is exactly what was written for this event."""
        if not self.comparison.same_version:
            return True
        return entry.t_ns == event.t_ns and self.comparison.same(entry.data, event)

    def _stop(self, event: Event, divergence: Divergence) -> Decided:
        self.kernel = None
        return Decided(event, None, divergence)

    def _divergence(
        self, event: str, recorded: JournalEntry, mine: Any, before: State | None
    ) -> Divergence:
        differences: list[str] = []
        if mine is not None and recorded.name == type(mine).__name__:
            differences = self.comparison.differences(recorded.data, to_json(mine))
        return Divergence(
            recorded.seq,
            recorded.t_ns,
            event,
            _text(recorded),
            "" if mine is None else text_of(mine),
            before,
            tuple(differences),
        )


def rerun(entries: Iterable[JournalEntry]) -> Divergence | None:
    """Return the first divergence of a fresh kernel from the journal, None where there is none.

    What stands before the first snapshot is passed over; the effects of the last event may be cut
    off, as a killed process leaves them. Raises UnreadableFile where entries are missing or are
    none of this version.
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
