"""Reads the journal: its entries in the order of their `seq`, as steps, and as kernel values.

Reading is ten times faster than with the codec of the kernel.
"""

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

_DECODERS: Mapping[Any, msgspec.json.Decoder[Any]] = MappingProxyType(
    {
        kind: msgspec.json.Decoder(kind)
        for kinds in (_EVENTS, _EFFECTS, _SNAPSHOT)
        for kind in kinds.values()
    }
)

_QUICK_EVENTS, _QUICK_EFFECTS = (
    {name: _DECODERS[kind].decode for name, kind in kinds.items()} for kinds in (_EVENTS, _EFFECTS)
)

_NOT_QUICK = (msgspec.DecodeError, RecursionError)
"""What a fast decoder raises; also for nan and inf, which are strings in the journal."""

KERNEL_FAILURES = (
    *(AssertionError, ArithmeticError, AttributeError, LookupError),
    *(NameError, RuntimeError, TypeError, ValueError),
)
"""What a kernel raises if it has a bug, or if its state was changed in the file.

`MemoryError` and `OSError` are left out: they do not come from the kernel or its state.
"""


def read_event(entry: JournalEntry) -> Event:
    """Return the event in an entry.

    Raises:
        UnreadableFile: It is not an event of this version.
    """
    try:
        event: Event = _QUICK_EVENTS[entry.name](entry.data)
    except (KeyError, *_NOT_QUICK):
        event = _read(_EVENTS, "event", entry)
    return event


def read_effect(entry: JournalEntry) -> Effect:
    """Return the effect in an entry.

    Raises:
        UnreadableFile: It is not an effect of this version.
    """
    try:
        effect: Effect = _QUICK_EFFECTS[entry.name](entry.data)
    except (KeyError, *_NOT_QUICK):
        effect = _read(_EFFECTS, "effect", entry)
    return effect


def read_snapshot(entry: JournalEntry) -> Snapshot:
    """Return the snapshot in an entry.

    Raises:
        UnreadableFile: It is not a snapshot of this version.
    """
    snapshot: Snapshot = _read(_SNAPSHOT, "snapshot", entry)
    if wrong := _wrong_in(snapshot.params):
        raise UnreadableFile(f"journal entry {entry.seq} cannot be read: {wrong}")
    return snapshot


@lru_cache(maxsize=4)
def _wrong_in(params: KernelParams) -> str:
    """Return why parameters are not allowed, or ""; cached, since most snapshots have the same."""
    try:
        check_all(Config(kernel=params))
    except ConfigError as error:
        return str(error)
    return ""


def decide(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
    """Return the effects of `event` in a kernel whose state came from a file.

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
    """Return the value in an entry; missing fields get defaults, unknown ones are ignored."""
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
    """Orders entries by `seq`: while a lower number is missing, holds back up to MAX_DISORDER."""

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
        if entry.seq == self._following and not self._held:
            self._following += 1
            yield entry
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
