"""Re-runs pieces of a journal, from one snapshot to the next, apart from the rest of a check.

A piece is confirmed if its entries follow each other, if a kernel that begins with its snapshot
decides exactly what is recorded and arrives at the next snapshot, and if it breaks no invariant. A
check need not re-run it, then: it takes the recorded decisions. It re-runs each other piece itself,
so that its report does not depend on how the recording was cut.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import OdomReceived
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry, is_snapshot
from robotctl.recording.read.journal_reader import EntryDecoder
from robotctl.recording.read.topic_places import Spot
from robotctl.rerun.agreed import Agreed
from robotctl.rerun.batch import Batch
from robotctl.rerun.comparison import Comparison
from robotctl.rerun.gc_pacing import rare_collections
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal_steps import Step
from robotctl.rerun.journal_values import read_snapshot
from robotctl.rerun.ordinary_run import OrdinaryRun, ordinary_runs
from robotctl.rerun.rerun import ConfirmedPiece, Rerun

MAX_UNUSED = 1000
"""A piece with more odometry that the kernel did not take as new is left to the check."""


BYTES = -1
"""The number of the job that reads every byte of a recording, instead of pieces."""

_SNAPSHOT = f"{Snapshot.__name__}\0".encode()
"""The name in the entry of a snapshot. Before a piece, places without it are passed over."""

MAX_STEPS = 512
"""How many steps are re-run at once."""


class Position(NamedTuple):
    """Where a journal entry stands: its place, and its number among the entries there."""

    file: int
    offset: int
    number: int


@rare_collections()
def confirmed_pieces(
    recording: Recording, topic: str, version: str, begin: Spot, end: Spot | None
) -> dict[Position, ConfirmedPiece]:
    """Return the confirmed pieces that begin from `begin` on and before `end`, by their begin."""
    found: dict[Position, ConfirmedPiece] = {}
    decoder = EntryDecoder(recording)
    piece: _Piece | None = None
    place, number, is_beyond = begin, -1, False
    start = Position(*begin, -1)

    def may_matter(records: bytes) -> bool:
        return piece is not None or _SNAPSHOT in records

    for spot, messages in recording.messages_from(topic, begin, may_matter):
        if spot is not place:
            place, number = spot, -1
            is_beyond = end is not None and spot >= end
        if is_beyond and piece is None:
            break
        if messages is None:
            piece = None
            continue
        for message in messages:
            number += 1
            if piece is None and not is_snapshot(message.data):
                continue
            try:
                entry = decoder.decode(message.data)
                if entry.kind is EntryKind.SNAPSHOT:
                    if piece is not None and piece.ends_with(entry):
                        found[start] = piece.confirmed()
                    piece = None if is_beyond else _Piece(version, entry)
                    start = Position(*spot, number)
                elif piece is not None and not piece.add(entry):
                    piece = None
            except UnreadableFile:
                piece = None
    return found


class _Piece:
    """A piece whose entries are taken one by one."""

    def __init__(self, version: str, snapshot: JournalEntry) -> None:
        """Begin with a snapshot.

        Raises:
            UnreadableFile: It cannot be read.
        """
        comparison = Comparison(version, read_snapshot(snapshot).made_by)
        self._rerun = Rerun(comparison)
        self._invariants = Invariants()
        begun, divergence = self._rerun.snapshot(snapshot)
        self._invariants.snapshot(begun)
        self._is_right = comparison.is_exact and divergence is None
        self._seq = snapshot.seq
        self._batch = Batch()
        self._unused: set[int] = set()

    def confirmed(self) -> ConfirmedPiece:
        """Return what a check must know of it, after it has ended."""
        return ConfirmedPiece(frozenset(self._unused))

    def add(self, entry: JournalEntry) -> bool:
        """Take an event or an effect; return whether the piece is right so far."""
        if entry.seq != self._seq + 1:
            return False
        self._seq = entry.seq
        if entry.kind is EntryKind.EFFECT:
            steps = self._batch.steps
            if not steps:
                return False
            steps[-1].effects.append(entry)
        else:
            if len(self._batch.steps) >= MAX_STEPS:
                self._take_steps()
            self._batch.add(Step(entry, []), (0, 0))
        return self._is_right

    def ends_with(self, snapshot: JournalEntry) -> bool:
        """Return whether the piece is right up to the snapshot that ends it.

        Raises:
            UnreadableFile: It cannot be read.
        """
        self._take_steps()
        return (
            self._is_right
            and snapshot.seq == self._seq + 1
            and self._rerun.snapshot(snapshot)[1] is None
            and not self._invariants.count
        )

    def _take_steps(self) -> None:
        batch, self._batch = self._batch, Batch()
        agreed = self._rerun.ahead(batch.steps) if self._is_right else []
        for part in ordinary_runs(batch, agreed):
            if isinstance(part, OrdinaryRun):
                self._invariants.run(part, was_checked=False)
                self._note_unused(part.by_kind[OdomReceived])
            elif part[2] is not None:
                self._invariants.step(part[2].seq, part[2].event, part[2].effects)
                self._note_unused([part[2]])
        is_whole = len(agreed) == len(batch.steps) and len(self._unused) <= MAX_UNUSED
        self._is_right = self._is_right and is_whole

    def _note_unused(self, steps: Iterable[Agreed]) -> None:
        self._unused.update(
            step.seq
            for step in steps
            if isinstance(step.event, OdomReceived)
            and step.measured.odometry_t_ns != step.event.t_ns
        )
