"""Figures in a terminal, in braille characters of two by four dots."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from robotctl.show.figure import Axis, Figure

DOTS_ACROSS, DOTS_DOWN = 2, 4

LABEL: Final = 11
"""The width of the numbers at the value axis, in characters."""

_BRAILLE: Final = 0x2800
_BITS: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""The bit of each dot of a braille cell, by column and row (Unicode, Braille Patterns)."""

_WANTED: Final = "wanted"
_WANTED_EVERY: Final = 3
"""One in this number of dots of a wanted path is set, as a difference from the driven one."""

_DRIVEN_COLOUR, _WANTED_COLOUR, _VALUE_COLOUR = "\x1b[32m", "\x1b[34m", "\x1b[36m"
_PLAIN: Final = "\x1b[0m"

_Dot = tuple[int, int]
_Cell = tuple[int, int]


class _Canvas:
    """Dots that are set, counted from the top left."""

    def __init__(self) -> None:
        self._cells: dict[_Cell, int] = {}

    def line(self, points: Sequence[_Dot], every: int = 1) -> set[_Cell]:
        """Set one in `every` dots on the lines between the points, and return their cells."""
        cells = set()
        for index, (x, y) in enumerate(_dots(points)):
            if index % every == 0:
                cell = x // DOTS_ACROSS, y // DOTS_DOWN
                bit = _BITS[x % DOTS_ACROSS][y % DOTS_DOWN]
                self._cells[cell] = self._cells.get(cell, 0) | bit
                cells.add(cell)
        return cells

    def character(self, column: int, row: int, *, ascii_only: bool = False) -> str:
        """Return the character of a cell, a space if all dots are off."""
        bits = self._cells.get((column, row), 0)
        if not bits:
            return " "
        return "*" if ascii_only else chr(_BRAILLE + bits)


def ground_lines(figure: Figure, *, rows: int = 18, colour: bool = False) -> list[str]:
    """Return a map as at most `rows` lines of text, plus two for the x axis in metres."""
    (left, right), (bottom, top) = figure.x, figure.y
    dots_per_m = (rows * DOTS_DOWN - 1) / max(right - left, top - bottom)
    across = int((right - left) * dots_per_m) // DOTS_ACROSS + 1
    down = int((top - bottom) * dots_per_m) // DOTS_DOWN + 1
    canvas = _Canvas()
    driven: set[_Cell] = set()
    for line in figure.lines:
        for run in line.runs:
            dots = [(round((x - left) * dots_per_m), round((top - y) * dots_per_m)) for x, y in run]
            if line.kind == _WANTED:
                canvas.line(dots, every=_WANTED_EVERY)
            else:
                driven |= canvas.line(dots)

    def cell(column: int, row: int) -> str:
        character = canvas.character(column, row)
        if not colour or character == " ":
            return character
        chosen = _DRIVEN_COLOUR if (column, row) in driven else _WANTED_COLOUR
        return f"{chosen}{character}{_PLAIN}"

    labels = {0: f"{top:.2f}", down - 1: f"{bottom:.2f}"}
    lines = [
        f"{labels.get(row, ''):>7} │" + "".join(cell(column, row) for column in range(across))
        for row in range(down)
    ]
    low, high = f"{left:.2f}", f"{right:.2f} m"
    gap = " " * max(1, across - len(low) - len(high))
    scale = f"a dot is {1000 / dots_per_m:.0f} mm"
    return [*lines, " " * 8 + "└" + "─" * across, f"{'':9}{low}{gap}{high}   {scale}"]


def time_lines(
    figure: Figure, *, width: int, rows: int, colour: bool, ascii_only: bool
) -> Iterator[str]:
    """Yield a figure as `rows` lines of text and a time axis, or nothing if it has no lines."""
    if not figure.lines:
        return
    across = max(width - LABEL - 1, 10)
    values = Axis(*figure.y, rows * DOTS_DOWN - 1, 0)
    time = Axis(*figure.x, 0, across * DOTS_ACROSS - 1)
    canvas = _Canvas()
    for line in figure.lines:
        for run in line.runs:
            canvas.line([(round(time.at(t_s)), round(values.at(value))) for t_s, value in run])
    for row in range(rows):
        label = {0: _label(values.high), rows - 1: _label(values.low)}.get(row, "")
        drawn = "".join(
            canvas.character(column, row, ascii_only=ascii_only) for column in range(across)
        ).rstrip()
        coloured = f"{_VALUE_COLOUR}{drawn}{_PLAIN}" if colour and drawn else drawn
        yield f"{label:>{LABEL - 1}} {'|' if ascii_only else '│'}{coloured}"
    end = f"{figure.x[1]:.2f} s"
    rule = ("-" if ascii_only else "─") * (across - len(end) - 4)
    yield f"{'':{LABEL}}{'+' if ascii_only else '└'} 0 {rule} {end}"


def _label(value: float) -> str:
    """Return a number with up to five significant digits, as many as fit."""
    texts = (f"{value:.{digits}g}" for digits in range(5, 0, -1))
    return next(text for text in texts if len(text) < LABEL)


def _dots(points: Sequence[_Dot]) -> Iterator[_Dot]:
    """Yield every dot on the lines between the points."""
    for (x0, y0), (x1, y1) in pairwise(points):
        steps = max(abs(x1 - x0), abs(y1 - y0))
        for step in range(steps):
            yield round(x0 + (x1 - x0) * step / steps), round(y0 + (y1 - y0) * step / steps)
    yield from points[-1:]
