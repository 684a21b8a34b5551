"""Re-run a journal in a new kernel, and compare its decisions with the recorded ones."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, get_args

import msgspec

from robotctl import __version__
from robotctl.base import retired
from robotctl.base.errors import UnreadableFile
from robotctl.check.journal import (
    KERNEL_FAILURES,
    Gap,
    Step,
    read_effect,
    read_event,
    read_snapshot,
    steps,
    text_of,
)
from robotctl.check.report import TOLERANCE, Divergence, Report
from robotctl.kernel.codec import Snapshot, to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.state import State
from robotctl.kernel.types import Decision, Effect, Event
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.format.names import MADE_BY, OWN_ARITHMETIC

MAX_FORMS = 4096
MAX_FORM_BYTES = 1000
"""Limits on the stored forms, the texts of entries without digits [forms, bytes]."""

_READERS = {
    EntryKind.EVENT: read_event,
    EntryKind.EFFECT: read_effect,
    EntryKind.SNAPSHOT: read_snapshot,
}


def without_retired_fields(entry: JournalEntry) -> JournalEntry:
    """Return the entry without those retired fields whose value is the former default."""
    names = {
        path.partition(".")[2]: default
        for path, default in retired.JOURNAL_FIELDS.items()
        if path.startswith(f"{entry.name}.") and f'"{path.rpartition(".")[2]}":' in entry.data
    }
    if not names:
        return entry
    try:
        data = json.loads(entry.data)
    except (ValueError, RecursionError):
        return entry
    for path, default in names.items():
        *sections, name = path.split(".")
        section = data
        for each in sections:
            section = section.get(each) if isinstance(section, dict) else None
        if isinstance(section, dict) and section.get(name) == default:
            section.pop(name, None)
    # As the journal is written: a float reads back to the same bits.
    return entry._replace(data=json.dumps(data, separators=(",", ":")))


class Vocabulary:
    """Finds fields in journal entries that this version does not know."""

    def __init__(self) -> None:
        self._known: set[tuple[str, bytes]] = set()

    def unknown_field(self, entry: JournalEntry) -> str:
        """Return the first field that this version would ignore, as `Name.path`, or "".

        Raises:
            UnreadableFile: The entry is not of this version.
        """
        # Entries that differ only in digits have one form, which is parsed once.
        form = (entry.name, entry.data.encode().translate(None, b"0123456789"))
        if form in self._known:
            return ""
        try:
            differing = _differing_fields(entry)
            unknown = next((f"{entry.name}.{name}" for is_new, name in differing if is_new), "")
        except RecursionError:
            raise UnreadableFile(f"journal entry {entry.seq} is nested too deeply") from None
        if not unknown and len(form[1]) <= MAX_FORM_BYTES and len(self._known) < MAX_FORMS:
            self._known.add(form)
        return unknown


class JournalFormat:
    """Compares the fields of a journal with those of this version."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._vocabulary: Vocabulary | None = Vocabulary()

    def begin(self, entry: JournalEntry) -> None:
        """Report a first snapshot that claims to be of this version, but has other fields.

        Raises:
            UnreadableFile: The entry is not a snapshot of this version.
        """
        report = self._report
        if report.same_version and (field := other_field(entry)):
            report.has_other_format = True
            report.miss(
                f"written by another version that calls itself {report.version}: its state {field}"
            )

    def compare(self, *entries: JournalEntry) -> None:
        """Report the first unknown field in `entries`.

        Raises:
            UnreadableFile: An entry is not of this version.
        """
        if self._vocabulary is None or self._report.same_version:
            return
        for entry in entries:
            if field := self._vocabulary.unknown_field(entry):
                self._report.miss_other_rules(f"entry {entry.seq}: {field!r} is not known")
                self._vocabulary = None
                return


def other_field(entry: JournalEntry) -> str:
    """Return the first differing field of a snapshot as "has NAME" or "lacks NAME", "" if none.

    Raises:
        UnreadableFile: The entry is not a snapshot of this version.
    """
    differing = _differing_fields(entry)
    return next((f"{'has' if is_new else 'lacks'} {name}" for is_new, name in differing), "")


def _differing_fields(entry: JournalEntry) -> Iterator[tuple[bool, str]]:
    """Return the `_differing` fields of an entry and of its value in this version."""
    ours = to_json(_READERS[entry.kind](entry))
    return _differing("", json.loads(entry.data), json.loads(ours))


def _differing(path: str, theirs: Any, ours: Any) -> Iterator[tuple[bool, str]]:
    """Yield the path of each field on only one side, and whether only `theirs` has it."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for name in ours:
            if name not in theirs:
                yield False, f"{path}{name}"
        for name, value in theirs.items():
            if name not in ours:
                yield True, f"{path}{name[:40]}"
            else:
                yield from _differing(f"{path}{name}.", value, ours[name])
    elif isinstance(theirs, list) and isinstance(ours, list):
        for each, own in zip(theirs, ours, strict=False):
            yield from _differing(f"{path.removesuffix('.')}[].", each, own)


WORDING = frozenset({"reason", "message", "stop_reason"})
"""Fields with sentences, which may differ between versions."""

_quick_json = msgspec.json.Encoder().encode
"""Same as `to_json` except for floats with an exponent, nan, inf, and text beyond ASCII."""

DECISION_NAMES = frozenset(kind.__name__ for kind in get_args(Decision))
"""Names of the effects that are compared in a recording of another version."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Compares recorded with new decisions; `version` and `made_by` are those of the recording."""

    version: str = __version__
    made_by: str = MADE_BY

    @property
    def same_version(self) -> bool:
        """Whether this version made the recording."""
        return self.version == __version__

    @property
    def same_arithmetic(self) -> bool:
        """Whether the recording's floats are from robotctl's own functions, not a C library's."""
        return self.made_by.startswith(OWN_ARITHMETIC)

    @property
    def is_exact(self) -> bool:
        """Whether everything is compared bit for bit."""
        return self.same_version and self.same_arithmetic

    def notes(self) -> Iterator[str]:
        """Yield a sentence for each limit on the exactness."""
        if not self.same_version:
            yield (
                f"made by robotctl {self.version or '(unknown version)'}, this is {__version__}: "
                f"compared are commands, modes, the latch and answers, without their wording"
            )
        if not self.same_arithmetic:
            yield (
                f"made with {self.made_by or 'an unknown Python'}, whose C library rounded "
                f"sin and cos: floats are compared to {TOLERANCE:g}"
            )

    def same(self, recorded: str, value: object) -> bool:
        """Return whether a recorded JSON text equals `value`, bit for bit only if `is_exact`."""
        if recorded.encode() == _quick_json(value):
            return True
        mine = to_json(value)
        if recorded == mine:
            return True
        return not self.is_exact and not self.differences(recorded, mine)

    def differences(self, recorded: str, decided: str) -> list[str]:
        """Return the differences of two JSON texts, each as "path: recorded ..., decided ..."."""
        try:
            theirs = json.loads(recorded)
        except (ValueError, RecursionError):
            return ["the recorded text is not JSON"]
        return [
            f"{path}: recorded {json.dumps(theirs)}, decided {json.dumps(mine)}"
            for path, theirs, mine in self._differing("", theirs, json.loads(decided))
        ]

    def _differing(self, path: str, theirs: Any, mine: Any) -> Iterator[tuple[str, Any, Any]]:
        if isinstance(theirs, dict) and isinstance(mine, dict):
            for name in self._comparable(theirs, mine):
                where = f"{path}.{name}" if path else name
                yield from self._differing(where, theirs.get(name), mine.get(name))
        elif isinstance(theirs, list) and isinstance(mine, list) and len(theirs) == len(mine):
            for position, (each, own) in enumerate(zip(theirs, mine, strict=True)):
                yield from self._differing(f"{path}[{position}]", each, own)
        elif not self._same_leaf(theirs, mine):
            yield path, theirs, mine

    def _comparable(self, theirs: dict[str, Any], mine: dict[str, Any]) -> list[str]:
        if self.same_version:
            return [*mine, *(name for name in theirs if name not in mine)]
        return [name for name in mine if name in theirs and name not in WORDING]

    def _same_leaf(self, theirs: Any, mine: Any) -> bool:
        if isinstance(theirs, float) and isinstance(mine, float) and not self.same_arithmetic:
            return abs(theirs - mine) <= TOLERANCE * max(1.0, abs(theirs), abs(mine))
        return repr(theirs) == repr(mine)


class Decided(NamedTuple):
    """The result of re-running a step; `effects` is None if it diverged or was not re-run."""

    event: Event
    effects: tuple[Effect, ...] | None = None
    divergence: Divergence | None = None


class Rerun:
    """A new kernel that decides on the recorded events from the first snapshot on.

    After a divergence or `stop`, `kernel` is None until the next snapshot.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        self.kernel: Kernel | None = None
        self._event: JournalEntry | None = None
        self._same_version = comparison.same_version

    def stop(self) -> None:
        """Drop the kernel until the next snapshot."""
        self.kernel = None

    def snapshot(self, entry: JournalEntry) -> tuple[Snapshot, Divergence | None]:
        """Compare the re-run kernel with a recorded snapshot, then continue from that snapshot.

        Return the snapshot, and the divergence or None. Without a kernel, only its text is checked.

        Raises:
            UnreadableFile: This version cannot read the snapshot, or rejects its parameters.
        """
        snapshot = read_snapshot(entry)
        kernel, self.kernel, self._event = self.kernel, snapshot.kernel(), None
        mine = replace(snapshot, params=kernel.params, state=kernel.state) if kernel else snapshot
        if self.comparison.same(entry.data, mine):
            return snapshot, None  # compared as texts, because nan is not equal to nan
        if not self._same_version and mine.params == snapshot.params:
            return snapshot, None  # parameters change by events alone, in every version
        return snapshot, self._divergence(entry, mine, kernel.state if kernel else None)

    def step(self, step: Step) -> Decided:
        """Pass the event of `step` to the kernel; compare its effects with the recorded ones.

        Raises:
            UnreadableFile: The entry is not an event of this version.
        """
        entry, kernel = step.event, self.kernel
        event = read_event(entry)
        if kernel is None:
            return Decided(event)
        self._event = entry
        before = kernel.state
        if self._same_version and not (
            entry.t_ns == event.t_ns and self.comparison.same(entry.data, event)
        ):  # the entry is not as robotctl writes this event
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
        """Return the difference between a recorded entry and a decision; one may be missing."""
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
    """Return the first divergence of a new kernel from the journal; None if they agree.

    Entries before the first snapshot are skipped. The last event may lack effects, as after a kill.

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
