"""The writer of the journal, which numbers and serializes the entries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Proof, Snapshot
from robotctl.kernel.types import Effect, Event
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, encode
from robotctl.recording.format.metadata_names import MADE_BY


class Journal:
    """The journal; each entry goes to `write` in order, serialized as a ROS message."""

    def __init__(
        self, write: Callable[[bytes, int], None], commands: Callable[[], int] = lambda: 0
    ) -> None:
        """`write(serialized, seq)` is called for each entry.

        `commands()` returns how many commands the journal accounts for so far.
        """
        self._write = write
        self._commands = commands
        self._seq = 0
        self._crc = 0

    def event(self, event: Event) -> None:
        """Write an event."""
        self._add(event.t_ns, EntryKind.EVENT, event)

    def effect(self, t_ns: int, effect: Effect) -> None:
        """Write an effect, with the time of the event that caused it."""
        self._add(t_ns, EntryKind.EFFECT, effect)

    def snapshot(self, t_ns: int, kernel: Kernel) -> None:
        """Write a snapshot, from which a re-run can start."""
        proof = Proof(self._commands(), self._crc)
        self._add(t_ns, EntryKind.SNAPSHOT, Snapshot(MADE_BY, kernel.params, kernel.state, proof))

    def _add(self, t_ns: int, kind: EntryKind, value: Any) -> None:
        entry = JournalEntry(self._seq, t_ns, kind, type(value).__name__, to_json(value))
        serialized = encode(entry)
        self._crc = chained(serialized, self._crc)
        self._write(serialized, self._seq)
        self._seq += 1
