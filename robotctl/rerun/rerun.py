"""A recorded journal decided once more by a fresh kernel: does it decide the same, bit for bit?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.state import State
from robotctl.kernel.types import Decision, Effect, Event
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.comparison import DECISION_NAMES, Comparison
from robotctl.rerun.journal_steps import Gap, Step, steps
from robotctl.rerun.journal_values import KERNEL_FAILURES, read_event, read_snapshot, text_of

MAX_SHAPES = 4096
"""A number may have a sign, a point and an exponent; a source may be any text."""


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

    def sentence(self) -> str:
        """The difference in one sentence."""
        differs = "; ".join(self.differences)
        if not differs:
            differs = f"recorded {self.recorded or 'nothing'}, decided {self.decided or 'nothing'}"
        return f"entry {self.seq}, after {self.event.partition(' ')[0]}: {differs}"


class Decided(NamedTuple):
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
        self._event: JournalEntry | None = None
        self._same_version = comparison.same_version
        self._shapes: set[bytes] = set()

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
        if not self._same_version or self.comparison.same(entry.data, mine):
            return snapshot, None  # as texts, for no nan equals another
        before = kernel.state if kernel else None
        return snapshot, self._divergence(entry, mine, before)

    def step(self, step: Step) -> Decided:
        """Decide on the step's event again. Raises UnreadableFile where the entry is not ours."""
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
            if (
                recorded.t_ns != entry.t_ns
                or recorded.name != type(effect).__name__
                or not self.comparison.same(recorded.data, effect)
            ):
                return self._diverged(event, recorded, effect, before)
        if len(theirs) > len(mine):
            return self._diverged(event, theirs[len(mine)], None, before)
        if len(theirs) < len(mine) and not step.cut:
            return self._diverged(event, None, mine[len(theirs)], before)
        return Decided(event, decided)

    def _is_untouched(self, entry: JournalEntry, event: Event) -> bool:
        """Whether the entry is what was written for this event, and nobody has changed it.

        Its text without the digits is compared with those that were right: the digits themselves
        are the event.
        """
        if not self._same_version:
            return True
        shape = entry.data.encode().translate(None, b"0123456789")
        if shape not in self._shapes:
            if not self.comparison.same(entry.data, event):
                return False
            if len(self._shapes) < MAX_SHAPES:
                self._shapes.add(shape)
        return entry.t_ns == event.t_ns

    def _diverged(
        self, event: Event, recorded: JournalEntry | None, mine: Any, before: State
    ) -> Decided:
        self.kernel = None
        return Decided(event, None, self._divergence(recorded, mine, before))

    def _divergence(
        self, recorded: JournalEntry | None, mine: Any, before: State | None
    ) -> Divergence:
        """The difference between an entry and what stands, or does not, in its place."""
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
