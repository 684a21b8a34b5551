"""Where in a recording the journal is being read, as another process would find it."""

from __future__ import annotations

from robotctl.recording.read.topic_places import Spot
from robotctl.rerun.piece import Position


class ReadingPosition:
    """The position of the last journal entry, as long as all entries followed each other."""

    def __init__(self) -> None:
        self._spot = Spot(0, 0)
        self._number = -1
        self._seq: int | None = None
        self._in_order = True

    def enter(self, spot: Spot) -> None:
        """Note that the next entries stand in this place."""
        self._spot = spot
        self._number = -1

    def entries(self, first: int, last: int) -> None:
        """Note entries in a row, with these numbers."""
        self._number += last - first + 1
        if self._seq is not None and first != self._seq + 1:
            self._in_order = False  # entries may be held back from now on
        self._seq = last

    @property
    def position(self) -> Position | None:
        """The position of the last entry; None if it may not be the one that is looked at."""
        return Position(*self._spot, self._number) if self._in_order else None
