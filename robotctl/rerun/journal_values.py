"""Reads kernel values from the journal, ten times faster than the codec of the kernel."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, get_args

import msgspec

from robotctl.base import retired
from robotctl.base.errors import ConfigError, UnreadableFile
from robotctl.config import Config, check_all
from robotctl.kernel.codec import Snapshot, from_json, to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
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
    """Step a kernel whose state came from a file.

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
