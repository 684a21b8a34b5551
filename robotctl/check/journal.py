"""Read the journal: put its entries in order, group them into steps, decode them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from heapq import heappop, heappush
from types import MappingProxyType
from typing import Any, final, get_args

import msgspec

from robotctl.base import retired
from robotctl.base.errors import ConfigError, UnreadableFile
from robotctl.config import Config, check_all
from robotctl.kernel.codec import Snapshot, from_json, to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import Effect, Event
from robotctl.recording.format.journal import EntryKind, JournalEntry

_EVENTS: Mapping[str, Any] = MappingProxyType({kind.__name__: kind for kind in get_args(Event)})
_EFFECTS: Mapping[str, Any] = MappingProxyType({kind.__name__: kind for kind in get_args(Effect)})
_SNAPSHOT: Mapping[str, Any] = MappingProxyType({Snapshot.__name__: Snapshot})

# Ten times as fast as `kernel.codec`, which is used where they fail.
_DECODERS: Mapping[Any, msgspec.json.Decoder[Any]] = MappingProxyType(
    {
        kind: msgspec.json.Decoder(kind)
        for kinds in (_EVENTS, _EFFECTS, _SNAPSHOT)
        for kind in kinds.values()
    }
)

_NOT_QUICK = (msgspec.DecodeError, RecursionError)
"""The errors of a fast decoder, also for nan and inf."""

# Without MemoryError and OSError, which do not come from the kernel or its state.
KERNEL_FAILURES = (
    *(AssertionError, ArithmeticError, AttributeError, LookupError),
    *(NameError, RuntimeError, TypeError, ValueError),
)
"""The errors of a kernel with a bug, or with a state that was changed in the file."""


def read_event(entry: JournalEntry) -> Event:
    """Return the event in an entry.

    Raises:
        UnreadableFile: The entry is not an event of this version.
    """
    event: Event = _read(_EVENTS, "event", entry)
    return event


def read_effect(entry: JournalEntry) -> Effect:
    """Return the effect in an entry.

    Raises:
        UnreadableFile: The entry is not an effect of this version.
    """
    effect: Effect = _read(_EFFECTS, "effect", entry)
    return effect


def read_snapshot(entry: JournalEntry) -> Snapshot:
    """Return the snapshot in an entry.

    Raises:
        UnreadableFile: The entry is not a snapshot of this version.
    """
    snapshot: Snapshot = _read(_SNAPSHOT, "snapshot", entry)
    if wrong := _wrong_in(snapshot.params):
        raise UnreadableFile(f"journal entry {entry.seq} cannot be read: {wrong}")
    return snapshot


@lru_cache(maxsize=4)
def _wrong_in(params: KernelParams) -> str:
    """Return the reason why parameters are not allowed, or ""."""
    try:
        check_all(Config(kernel=params))
    except ConfigError as error:
        return str(error)
    return ""


def decide(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
    """Return the effects of `event` on a kernel whose state is from a file.

    Raises:
        UnreadableFile: The kernel cannot continue from its state.
    """
    try:
        return kernel.step(event)
    except KERNEL_FAILURES as error:
        raise UnreadableFile(
            f"the kernel cannot go on from this journal: {type(error).__name__}: {error}"[:200]
        ) from None


def text_of(value: Event | Effect | Snapshot) -> str:
    """Return the value as a line of text: `Name {json}`."""
    return f"{type(value).__name__} {to_json(value)}"


def _read(kinds: Mapping[str, Any], noun: str, entry: JournalEntry) -> Any:
    """Return the value in an entry; missing fields get defaults, unknown fields are ignored."""
    kind = kinds.get(entry.name)
    try:
        if kind is None:
            raise ValueError(f"no {noun} is called {entry.name[:40]!r}")
        try:
            return _DECODERS[kind].decode(entry.data)
        except _NOT_QUICK:
            return from_json(kind, entry.data)
    except ValueError as error:
        named = next((each for each in retired.CAUSES if json.dumps(each) in entry.data), None)
        why = f"it names {named!r}, which is retired: {retired.CAUSES[named]}" if named else error
        raise UnreadableFile(f"journal entry {entry.seq} cannot be read: {why}") from None


# A file that another program sorted by time is out of order if the clock was set.
MAX_DISORDER = 4096
"""The maximum number of entries held back for a missing lower number."""


@final
@dataclass(frozen=True, slots=True)
class Gap:
    """A place where journal entries are missing or out of order; `text` is a sentence about it."""

    text: str


def in_sequence(entries: Iterable[JournalEntry]) -> Iterator[JournalEntry | Gap]:
    """Yield the entries ordered by `seq`, and the gaps and repetitions among them."""
    held: list[tuple[int, int, JournalEntry]] = []
    first: int | None = None
    following = 0

    def released(at_most: int) -> Iterator[JournalEntry | Gap]:
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

    for number, entry in enumerate(entries):
        if first is None:
            first = following = entry.seq
        if entry.seq < first:
            yield Gap(f"the journal is not in order: entry {entry.seq} follows {first}")
            first = entry.seq
        elif entry.seq == following and not held:
            following += 1
            yield entry
        else:
            heappush(held, (entry.seq, number, entry))
            yield from released(MAX_DISORDER)
    yield from released(0)


def _missing(first: int, last: int) -> Gap:
    if first == last:
        return Gap(f"the journal lacks entry {first}")
    return Gap(f"the journal lacks the entries {first} to {last}")


Moments = tuple[int, int, int]
"""Begin of a step by the steady clock, its begin and its end by the wall clock [ns]."""


@dataclass(slots=True)
class Step:
    """One event and its recorded effects."""

    event: JournalEntry
    effects: list[JournalEntry] = field(default_factory=list)
    cut: bool = False
    """Whether the journal ends or has a gap after the step: effects may be missing."""


Item = Step | JournalEntry | Gap
"""A step, a snapshot, or a gap in the journal."""


def steps(entries: Iterable[JournalEntry]) -> Iterator[Item]:
    """Yield steps, snapshots (as entries) and gaps of a journal; skip effects without an event."""
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
