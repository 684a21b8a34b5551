"""Checks that no journal entry between two snapshots was changed, removed or added."""

from __future__ import annotations

from robotctl.kernel.snapshot import Proof
from robotctl.recording.format.journal import JournalEntry, chained, encode


class JournalChain:
    """The CRC of all entries, continued from a snapshot and compared at the next one."""

    def __init__(self) -> None:
        self._seq = -1
        self._crc: int | None = None
        """The CRC up to the last entry, None after a gap."""

        self._before: int | None = None
        """The CRC before the last entry."""

    def add(self, seq: int, serialized: bytes) -> None:
        """Take the next entry as it is recorded."""
        follows = seq == self._seq + 1
        self._seq = seq
        self._before = self._crc if follows else None
        self._crc = None if self._before is None else chained(serialized, self._before)

    def is_whole(self, entry: JournalEntry, proof: Proof | None) -> bool:
        """Return whether the entries before a snapshot are those that were written.

        They count as whole where that is not known: at the beginning and after a gap.
        """
        if proof is None:
            return True
        is_last = entry.seq == self._seq
        known = self._before if is_last else None
        if is_last:
            self._crc = chained(encode(entry), proof.journal_crc)
        return known is None or known == proof.journal_crc
