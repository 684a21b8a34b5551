"""Checks the proof in each snapshot against the journal before it; 0.1.0 wrote no proofs."""

from __future__ import annotations

from typing import Final

from robotctl.kernel.codec import Proof
from robotctl.recording.format.journal import JournalEntry, chained_all, encode
from robotctl.rerun.check_report import Report
from robotctl.rerun.invariants import Invariants

MAX_ENTRIES = 512
"""The CRC is computed once for about this many entries."""


class JournalChain:
    """Computes the CRC of the entries after a snapshot, and compares it at the next snapshot."""

    def __init__(self) -> None:
        self._seq = -1
        self._entries: list[bytes] = []
        """The last entries, serialized; `_crc` does not include them yet."""

        self._crc: int | None = None
        """The CRC of all entries before `_entries`, None after a gap."""

    def add(self, seq: int, *serialized: bytes) -> None:
        """Add the next entries, serialized; they are numbered from `seq` on."""
        if seq != self._seq + 1:
            self._crc = None
            self._entries.clear()
        self._seq = seq + len(serialized) - 1
        self._entries += serialized
        if len(self._entries) > MAX_ENTRIES:
            self._continue()

    def _continue(self) -> None:
        """Include all entries but the last one in the CRC."""
        *earlier, last = self._entries
        if self._crc is not None:
            self._crc = chained_all(earlier, self._crc)
        self._entries = [last]

    def is_whole(self, entry: JournalEntry, proof: Proof | None) -> bool:
        """Return whether the CRC of the entries before a snapshot is that of its proof.

        Return True if one of the two is unknown: without a proof, at the beginning, after a gap.
        """
        if proof is None:
            return True
        known = None
        if entry.seq == self._seq:
            self._continue()
            known = self._crc
            self._entries, self._crc = [encode(entry)], proof.journal_crc
        return known is None or known == proof.journal_crc


WITHOUT_PROOF: Final = "0.1.0"
"""The version that wrote no proofs."""

NOT_COMPARED: Final = (
    f"version {WITHOUT_PROOF} did not number what it sent and wrote: not compared are commands, "
    "inputs, statuses, calls, and whether the journal is whole"
)


class SnapshotProofs:
    """Checks the proofs in one journal: either all of its snapshots have one, or none has."""

    def __init__(self, report: Report, chain: JournalChain, invariants: Invariants) -> None:
        self._report = report
        self._chain = chain
        self._invariants = invariants
        self._has_proofs: bool | None = None
        """Whether each snapshot must have a proof, None before the first snapshot."""

        self._is_told = False

    def check(self, entry: JournalEntry, proof: Proof | None, before: int) -> None:
        """Check the next snapshot; `before` is the number of the one before it."""
        if not self._chain.is_whole(entry, proof):
            self._invariants.violate(
                f"the journal was changed between its entries {before} and {entry.seq}"
            )
        has_proof = proof is not None
        if self._has_proofs is None:
            self._has_proofs = has_proof or self._report.version != WITHOUT_PROOF
            if not self._has_proofs:
                self._report.notes.append(NOT_COMPARED)
        if has_proof is not self._has_proofs and not self._is_told:
            self._is_told = True
            self._tell(entry, has_proof=has_proof)

    def _tell(self, entry: JournalEntry, *, has_proof: bool) -> None:
        does = "tells" if has_proof else "does not tell"
        text = f"the snapshot in entry {entry.seq} {does} what was sent and written before it"
        if self._report.same_version:
            self._invariants.violate(text, (entry.seq, entry.t_ns))
        else:
            who = "those" if has_proof else "only those"
            self._report.miss(f"{text}: {who} of version {WITHOUT_PROOF} do not")
