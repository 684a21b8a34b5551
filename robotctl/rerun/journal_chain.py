"""Checks that no journal entry between two snapshots was changed, removed or added."""

from __future__ import annotations

from robotctl.kernel.snapshot import Proof
from robotctl.recording.format.journal import JournalEntry, chained_all, encode

MAX_ENTRIES = 512
"""How many entries are kept, so that their CRC is computed at once."""


class JournalChain:
    """The CRC of all entries, continued from a snapshot and compared at the next one."""

    def __init__(self) -> None:
        self._seq = -1
        self._entries: list[bytes] = []
        """The last entries, as they are recorded."""

        self._crc: int | None = None
        """The CRC of all entries before these, None after a gap."""

    def add(self, seq: int, *serialized: bytes) -> None:
        """Take the next entries as they are recorded; they are numbered from `seq` on."""
        if seq != self._seq + 1:
            self._crc = None
            self._entries.clear()
        self._seq = seq + len(serialized) - 1
        self._entries += serialized
        if len(self._entries) > MAX_ENTRIES:
            self._continue()

    def _continue(self) -> None:
        """Continue the CRC up to the entry before the last one."""
        *earlier, last = self._entries
        if self._crc is not None:
            self._crc = chained_all(earlier, self._crc)
        self._entries = [last]

    def is_whole(self, entry: JournalEntry, proof: Proof | None) -> bool:
        """Return whether the entries before a snapshot are those that were written.

        They count as whole where that is not known: at the beginning and after a gap.
        """
        if proof is None:
            return True
        known = None
        if entry.seq == self._seq:
            self._continue()
            known = self._crc
            self._entries, self._crc = [encode(entry)], proof.journal_crc
        return known is None or known == proof.journal_crc
