"""A recorded journal decided once more by a fresh kernel: does it decide the same, bit for bit?"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, get_args

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import from_json, to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import Event
from robotctl.recording.journal import JournalEntry, Kind

_EVENTS: Mapping[str, Any] = MappingProxyType({kind.__name__: kind for kind in get_args(Event)})


@dataclass(frozen=True, slots=True)
class Divergence:
    """Where a fresh kernel decided differently, as texts `Name {json}`; "" where one is missing.

    `seq` and `t_ns` are those of the recorded entry at which it shows, `event` is what both
    kernels had to decide on.
    """

    seq: int
    t_ns: int
    event: str
    recorded: str
    decided: str


def rerun(entries: Iterable[JournalEntry]) -> Divergence | None:
    """Return the first divergence of a fresh kernel from the journal, None where there is none.

    `entries` are in the order of their `seq`. What stands before the first snapshot is passed
    over; the effects of the last event may be cut off, as a killed process leaves them. Raises
    UnreadableFile where entries are missing or are none of this version.
    """
    kernel: Kernel | None = None
    decided: deque[str] = deque()
    event = ""
    last: int | None = None
    for entry in entries:
        if last is not None and entry.seq != last + 1:
            raise UnreadableFile(f"the journal lacks the entries {last + 1} to {entry.seq - 1}")
        last = entry.seq
        recorded = f"{entry.name} {entry.data}"
        if entry.kind is Kind.EFFECT:
            expected = decided.popleft() if decided else ""
            if kernel is not None and recorded != expected:
                return Divergence(entry.seq, entry.t_ns, event, recorded, expected)
            continue
        if decided:
            return Divergence(entry.seq, entry.t_ns, event, "", decided[0])
        if entry.kind is Kind.SNAPSHOT:
            snapshot = _read(Snapshot, entry)
            if kernel is not None:  # as texts, for no nan equals another
                mine = to_json(Snapshot(snapshot.made_by, kernel.params, kernel.state))
                if mine != entry.data:
                    return Divergence(
                        entry.seq, entry.t_ns, event, recorded, f"{entry.name} {mine}"
                    )
            kernel = snapshot.kernel()
        elif kernel is not None:
            event = recorded
            effects = kernel.step(_read(_EVENTS.get(entry.name), entry))
            decided.extend(f"{type(effect).__name__} {to_json(effect)}" for effect in effects)
    return None


def _read(kind: Any, entry: JournalEntry) -> Any:
    try:
        if kind is None:
            raise ValueError(f"no event is called {entry.name!r}")
        return from_json(kind, entry.data)
    except ValueError as error:
        raise UnreadableFile(f"journal entry {entry.seq} is not ours: {error}") from None
