"""Counts of what was read of a file so far: the work it took, and the messages found."""

from __future__ import annotations

from collections.abc import Iterable


class ReadTally:
    """Counts by the offset of a place, so that a place that is read twice counts once."""

    def __init__(self) -> None:
        self._records: dict[int, int] = {}
        self._unpacked: dict[int, int] = {}
        self._messages: dict[int, int] = {}
        self._record_total = 0
        self._unpacked_total = 0

    def records_left(self, offset: int, limit: int) -> int:
        """Return how many of `limit` records the place at `offset` may hold, given all other
        places.
        """
        return limit - self._record_total + self._records.get(offset, 0)

    def note_records(self, offset: int, count: int) -> None:
        """Set the number of records found at a place, up to its end or a tear."""
        self._record_total += count - self._records.get(offset, 0)
        self._records[offset] = count

    def unpacked_left(self, offset: int, limit: int) -> int:
        """Return what of `limit` the decompression of single messages at a place may cost."""
        return limit - self._unpacked_total + self._unpacked.get(offset, 0)

    def note_unpacked(self, offset: int, cost: int) -> None:
        """Set what the decompression of single messages at a place has cost in one reading."""
        known = self._unpacked.get(offset, 0)
        if cost > known:
            self._unpacked_total += cost - known
            self._unpacked[offset] = cost

    def note_messages(self, offset: int, count: int) -> None:
        """Set the number of messages at a place that was read to its end."""
        self._messages[offset] = count

    def messages_in(self, offsets: Iterable[int]) -> int | None:
        """Return the message count of these places; None if one was not read to its end."""
        total = 0
        for offset in offsets:
            count = self._messages.get(offset)
            if count is None:
                return None
            total += count
        return total
