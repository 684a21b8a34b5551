"""A picture of the driven path over the reference path, in braille characters or as a PNG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robotctl.cli.terminal.braille_canvas import BrailleCanvas
from robotctl.recording.disk.replaced_file import replaced_file

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

Point = Sequence[float]
"""x and y in metres."""

Path2D = Sequence[Point]

_MIN_SPAN_M = 0.1
"""The size of the picture of a robot that did not move."""

_REFERENCE_EVERY = 3
"""The reference path is dotted, so that it differs from the driven one without colour."""

_DRIVEN_COLOUR, _REFERENCE_COLOUR, _PLAIN = "\x1b[32m", "\x1b[34m", "\x1b[0m"


@dataclass(frozen=True, slots=True)
class Bounds:
    """The smallest rectangle, in metres, around all points."""

    left: float
    bottom: float
    right: float
    top: float

    @classmethod
    def around(cls, *paths: Path2D) -> Bounds:
        """Return the rectangle around every finite point of the paths."""
        points = [(x, y) for path in paths for x, y in finite(path)] or [(0.0, 0.0)]
        left, right = _spread([x for x, _ in points])
        bottom, top = _spread([y for _, y in points])
        return cls(left, bottom, right, top)

    @property
    def span(self) -> float:
        """The longer side, in metres."""
        return max(self.right - self.left, self.top - self.bottom)


def braille(
    reference: Path2D, driven: Path2D, *, rows: int = 18, colour: bool = False
) -> list[str]:
    """Return the picture as lines of text, with axes in metres and of equal scale."""
    bounds = Bounds.around(reference, driven)
    dots_per_m = (rows * 4 - 1) / bounds.span
    across = int((bounds.right - bounds.left) * dots_per_m) // 2 + 1
    down = int((bounds.top - bounds.bottom) * dots_per_m) // 4 + 1

    def place(path: Path2D) -> list[tuple[int, int]]:
        return [
            (round((x - bounds.left) * dots_per_m), round((bounds.top - y) * dots_per_m))
            for x, y in finite(path)
        ]

    canvas = BrailleCanvas()
    canvas.line(place(reference), every=_REFERENCE_EVERY)
    driven_cells = canvas.line(place(driven))

    def cell(column: int, row: int) -> str:
        character = canvas.character(column, row)
        if not colour or character == " ":
            return character
        chosen = _DRIVEN_COLOUR if (column, row) in driven_cells else _REFERENCE_COLOUR
        return f"{chosen}{character}{_PLAIN}"

    labels = {0: f"{bounds.top:.2f}", down - 1: f"{bounds.bottom:.2f}"}
    lines = [
        f"{labels.get(row, ''):>7} \u2502" + "".join(cell(column, row) for column in range(across))
        for row in range(down)
    ]
    left, right = f"{bounds.left:.2f}", f"{bounds.right:.2f} m"
    gap = " " * max(1, across - len(left) - len(right))
    scale = f"a dot is {1000 / dots_per_m:.0f} mm"
    axis = " " * 8 + "\u2514" + "\u2500" * across
    return [*lines, axis, f"{'':9}{left}{gap}{right}   {scale}"]


def write_png(file: Path, reference: Path2D, driven: Path2D, title: str) -> None:
    """Write the picture as a PNG, with axes of equal scale and the access rights of its folder.

    A picture that is there is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    from PIL import Image, ImageDraw

    canvas = Image.new("RGB", (_Plot.SIZE * _Plot.FINE,) * 2, "white")
    plot = _Plot(ImageDraw.Draw(canvas), Bounds.around(reference, driven))
    plot.axes(title)
    plot.path(reference, "#9db8d9", 6, "reference", 0)
    plot.path(driven, "#d1481f", 2, "driven", 1)
    with replaced_file(file) as stream:
        canvas.resize((_Plot.SIZE,) * 2, Image.Resampling.LANCZOS).save(stream, "PNG")


def finite(path: Path2D) -> list[tuple[float, float]]:
    """Return the points of a path that can be drawn."""
    return [(x, y) for x, y in path if math.isfinite(x) and math.isfinite(y)]


class _Plot:
    """A canvas `FINE` times as large as the picture, for drawing in metres."""

    SIZE = 800
    FINE = 4
    MARGIN = 80

    def __init__(self, draw: ImageDraw, bounds: Bounds) -> None:
        from PIL import ImageFont

        self._draw = draw
        self._font = ImageFont.load_default(16 * self.FINE)
        self._span = bounds.span * 1.08
        self._scale = (self.SIZE - 2 * self.MARGIN) / self._span
        self._left = (bounds.left + bounds.right - self._span) / 2
        self._top = (bounds.bottom + bounds.top + self._span) / 2

    def axes(self, title: str) -> None:
        """Draw a frame, a grid with numbers in metres, and the title."""
        low, high = self.MARGIN, self.SIZE - self.MARGIN
        for x in _ticks(self._left, self._left + self._span):
            at = self._x(x)
            self._line([(at, low), (at, high)], "#e6e6e6", 1)
            self._text(at, high + 8, f"{x:g}", "ma")
        for y in _ticks(self._top - self._span, self._top):
            at = self._y(y)
            self._line([(low, at), (high, at)], "#e6e6e6", 1)
            self._text(low - 8, at, f"{y:g}", "rm")
        corners = [(low, low), (high, low), (high, high), (low, high), (low, low)]
        self._line(corners, "#808080", 1)
        self._text(self.SIZE / 2, 16, title, "ma")
        self._text(self.SIZE / 2, self.SIZE - 34, "x [m]", "ma")
        self._text(low, low - 8, "y [m]", "rs")

    def path(self, points: Path2D, colour: str, width: int, name: str, entry: int) -> None:
        """Draw a path, and its entry in the legend."""
        line = [(self._x(x), self._y(y)) for x, y in finite(points)]
        if line:
            self._line(line, colour, width)
        x, y = self.MARGIN + 120 * entry, self.MARGIN - 24
        self._line([(x + 20, y), (x + 50, y)], colour, width)
        self._text(x + 58, y, name, "lm")

    def _x(self, metres: float) -> float:
        return self.MARGIN + (metres - self._left) * self._scale

    def _y(self, metres: float) -> float:
        return self.MARGIN + (self._top - metres) * self._scale

    def _line(self, points: Iterable[tuple[float, float]], colour: str, width: int) -> None:
        fine = [(x * self.FINE, y * self.FINE) for x, y in points]
        self._draw.line(fine, fill=colour, width=width * self.FINE, joint="curve")

    def _text(self, x: float, y: float, text: str, anchor: str) -> None:
        at = (x * self.FINE, y * self.FINE)
        self._draw.text(at, text, fill="#404040", font=self._font, anchor=anchor)


def _spread(values: list[float]) -> tuple[float, float]:
    """Return the smallest and the largest value, at least _MIN_SPAN_M apart."""
    low, high = min(values), max(values)
    missing = max(0.0, _MIN_SPAN_M - (high - low)) / 2
    return low - missing, high + missing


def _ticks(low: float, high: float) -> list[float]:
    """Return four to ten round numbers between two numbers."""
    rough = (high - low) / 8
    magnitude = 10.0 ** math.floor(math.log10(rough))
    step = next(m for m in (1, 2, 5, 10) if m * magnitude >= rough) * magnitude
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(number * step, 9) for number in range(first, last + 1)]
