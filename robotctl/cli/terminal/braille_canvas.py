"""Lines drawn with the dots of braille characters: two across and four down in each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

DOTS_ACROSS, DOTS_DOWN = 2, 4

_BRAILLE: Final = 0x2800
_BITS: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""The bit of each dot of a braille cell, by column and row (Unicode, Braille Patterns)."""

Dot = tuple[int, int]


class BrailleCanvas:
    """Dots that are set, counted from the top left."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], int] = {}

    def line(self, points: Sequence[Dot], every: int = 1) -> set[tuple[int, int]]:
        """Set each dot on the lines between the points, or one of `every`; return their cells."""
        cells = set()
        for index, (x, y) in enumerate(_dots(points)):
            if index % every == 0:
                cell = x // DOTS_ACROSS, y // DOTS_DOWN
                bit = _BITS[x % DOTS_ACROSS][y % DOTS_DOWN]
                self._cells[cell] = self._cells.get(cell, 0) | bit
                cells.add(cell)
        return cells

    def character(self, column: int, row: int, *, ascii_only: bool = False) -> str:
        """Return the character of a cell, a space without a dot."""
        bits = self._cells.get((column, row), 0)
        if not bits:
            return " "
        return "*" if ascii_only else chr(_BRAILLE + bits)


def _dots(points: Sequence[Dot]) -> Iterator[Dot]:
    """Yield every dot on the lines between the points."""
    for (x0, y0), (x1, y1) in pairwise(points):
        steps = max(abs(x1 - x0), abs(y1 - y0))
        for step in range(steps):
            yield round(x0 + (x1 - x0) * step / steps), round(y0 + (y1 - y0) * step / steps)
    yield from points[-1:]
