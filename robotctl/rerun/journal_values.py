"""Kernel values read from the journal, ten times as fast as the kernel's own codec reads them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, get_args

import msgspec

from robotctl.config import Config, check_all
from robotctl.errors import ConfigError, UnreadableFile
from robotctl.kernel.codec import from_json, to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import Effect, Event
from robotctl.recording.format.journal import JournalEntry

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

KERNEL_FAILURES = (AssertionError, ArithmeticError, LookupError, ValueError, TypeError)
"""What a kernel may raise in a state that no kernel has come to by itself."""


def read_event(entry: JournalEntry) -> Event:
    """The event in an entry; raises UnreadableFile where it is none of this version."""
    event: Event = _read(_EVENTS, "event", entry)
    return event


def read_effect(entry: JournalEntry) -> Effect:
    """The effect in an entry; raises UnreadableFile where it is none of this version."""
    effect: Effect = _read(_EFFECTS, "effect", entry)
    return effect


def read_snapshot(entry: JournalEntry) -> Snapshot:
    """The snapshot in an entry; raises UnreadableFile where it is none of this version."""
    snapshot: Snapshot = _read(_SNAPSHOT, "snapshot", entry)
    try:
        check_all(Config(kernel=snapshot.params))
    except ConfigError as error:
        raise UnreadableFile(f"journal entry {entry.seq} is not ours: {error}") from None
    return snapshot


def decide(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
    """Step a kernel whose state came from a file; raises UnreadableFile where it cannot."""
    try:
        return kernel.step(event)
    except KERNEL_FAILURES as error:
        raise UnreadableFile(
            f"the kernel cannot go on from this journal: {type(error).__name__}: {error}"[:200]
        ) from None


def text_of(value: Event | Effect | Snapshot) -> str:
    """The value as a line of the journal: `Name {json}`."""
    return f"{type(value).__name__} {to_json(value)}"


def _read(kinds: Mapping[str, Any], noun: str, entry: JournalEntry) -> Any:
    """What another version has left out gets its default; what it has added is passed over."""
    kind = kinds.get(entry.name)
    try:
        if kind is None:
            raise ValueError(f"no {noun} is called {entry.name[:40]!r}")
        try:
            return _DECODERS[kind].decode(entry.data)
        except (msgspec.DecodeError, RecursionError):  # nan and inf are strings there
            return from_json(kind, entry.data)
    except ValueError as error:
        raise UnreadableFile(f"journal entry {entry.seq} is not ours: {error}") from None
