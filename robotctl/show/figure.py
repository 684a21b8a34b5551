"""A figure as data: lines over time or on the ground. `svg`, `png` and `terminal` draw it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10
from typing import Final

RELATIVE_SPAN: Final = 1e-9
SMALLEST_SPAN: Final = 1e-300
"""Minimum span of an axis, as a share of the largest value and absolute, for a finite scale."""

MIN_SPAN_M: Final = 0.1
"""The smallest span of an axis on the ground, for a robot that did not move."""

VALUE_ROOM: Final = 0.06
"""The free space above and below the values of a plot, as a share of their span."""

GROUND_ROOM: Final = 1.08
"""The size of a picture on the ground, as a multiple of the size of its paths."""

DIGIT_PX: Final = 7.5
"""The largest width of a digit at an axis [pixels]."""

Point = tuple[float, float]
Span = tuple[float, float]
Path2D = Iterable[Sequence[float]]
"""Points on the ground, x and y in metres."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Maps `low` to the pixel `begin` and `high` to the pixel `end`."""

    low: float
    high: float
    begin: float
    end: float

    @property
    def scale(self) -> float:
        """The number of pixels per unit of the values."""
        return (self.end - self.begin) / (self.high - self.low)

    def at(self, value: float) -> float:
        """Return the pixel of `value` on this axis."""
        return self.begin + (value - self.low) * self.scale

    def ticks(self, at_most: int) -> list[float]:
        """Return at most `at_most` + 1 evenly spaced round numbers from `low` to `high`."""
        rough = (self.high - self.low) / at_most
        magnitude = 10.0 ** floor(log10(rough))
        step = next(m for m in (1.0, 2.0, 5.0, 10.0) if m * magnitude >= rough * 0.999) * magnitude
        first, last = ceil(self.low / step - 1e-6), floor(self.high / step + 1e-6)
        return [number * step for number in range(first, last + 1)]


@dataclass(frozen=True, slots=True)
class Frame:
    """The size of a picture and the edges of its axes [pixels]."""

    width: float
    height: float
    left: float
    right: float
    top: float
    bottom: float


@dataclass(frozen=True, slots=True)
class Line:
    """Unbroken runs of points, with the style `kind` and a `name` for the legend."""

    runs: Sequence[Sequence[Point]]
    kind: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """The lines of a plot and the spans of its axes. Later lines cover earlier ones.

    In a plot over time, x is in seconds. In a map (`is_ground`), x and y are metres of equal scale.
    """

    title: str
    lines: tuple[Line, ...]
    x: Span
    y: Span
    is_ground: bool = False

    def axes(self, frame: Frame) -> tuple[Axis, Axis]:
        """Return the x and the y axis, which map values to pixels of `frame`."""
        across, down = frame.right - frame.left, frame.bottom - frame.top
        x, y = self.x, self.y
        if self.is_ground:
            wide, high = (GROUND_ROOM * (high - low) for low, high in (x, y))
            scale = min(across / wide, down / high)
            x, y = _around(x, across / scale), _around(y, down / scale)
        return Axis(*x, frame.left, frame.right), Axis(*y, frame.bottom, frame.top)


def time_figure(
    title: str,
    lines: Iterable[Line],
    duration_s: float,
    *,
    least_span: float = 0.0,
    from_zero: bool = False,
) -> Figure:
    """Return a figure over time, whose y axis spans at least `least_span`."""
    drawn = tuple(line for line in lines if line.runs)
    values = [value for line in drawn for run in line.runs for _, value in run] or [0.0]
    low, high = 0.0 if from_zero else min(values), max(values)
    missing = max(least_span, _least_span(low, high)) - (high - low)
    low, high = low - max(missing, 0.0) / 2.0, high + max(missing, 0.0) / 2.0
    room = VALUE_ROOM * (high - low)
    span = (0.0 if from_zero else low - room, high + room)
    return Figure(title, drawn, (0.0, max(duration_s, 1e-3)), span)


def ground_figure(title: str, lines: Iterable[Line]) -> Figure:
    """Return a map of paths on the ground, with x and y in metres."""
    drawn = tuple(lines)
    points = [point for line in drawn for run in line.runs for point in run] or [(0.0, 0.0)]
    limits = [(min(values), max(values)) for values in zip(*points, strict=True)]
    spans = [_around(span, max(span[1] - span[0], MIN_SPAN_M)) for span in limits]
    return Figure(title, drawn, spans[0], spans[1], is_ground=True)


def path_figure(reference: Path2D, driven: Path2D, title: str = "") -> Figure:
    """Return a map of the driven path over the reference path, without points that are infinite."""
    lines = [
        Line([points] if points else [], kind, name)
        for points, kind, name in (
            (_finite(reference), "wanted", "reference"),
            (_finite(driven), "driven", "driven"),
        )
    ]
    return ground_figure(title, lines)


@dataclass(frozen=True, slots=True)
class Stroke:
    """Lines through points [pixels], in the style `kind`."""

    runs: Sequence[Sequence[Point]]
    kind: str


@dataclass(frozen=True, slots=True)
class Label:
    """A text at height `y` [pixels]. `x` is the middle of the text or, if `is_end`, its end."""

    text: str
    x: float
    y: float
    kind: str
    is_end: bool = False


def laid_out(figure: Figure, frame: Frame) -> Iterator[Stroke | Label]:
    """Yield the grid, numbers and lines of a figure, or nothing if it has no lines."""
    if not figure.lines:
        return
    x, y = figure.axes(frame)
    for tick in y.ticks(8 if figure.is_ground else 4):
        at, text = y.at(tick), f"{tick:.12g}"
        yield Stroke([[(frame.left, at), (frame.right, at)]], "grid")
        end = max(frame.left - 6, len(text) * DIGIT_PX)  # further right if a long number needs it
        yield Label(text, end, at, "value", is_end=True)
    yield from x_ticks(figure, frame)
    if figure.is_ground:
        yield Label("x [m]", frame.right, frame.bottom + 26, "tick", is_end=True)
        yield Label("y [m]", frame.left - 6, frame.top - 6, "value", is_end=True)
    for line in figure.lines:
        placed = [[(x.at(a), y.at(b)) for a, b in run] for run in line.runs if run]
        if placed:
            yield Stroke(placed, line.kind)


def x_ticks(figure: Figure, frame: Frame) -> Iterator[Stroke | Label]:
    """Yield the grid lines and the numbers of the x axis."""
    x, _ = figure.axes(frame)
    for tick in x.ticks(8 if figure.is_ground else 12):
        at, text = x.at(tick), f"{tick:.12g}" if figure.is_ground else f"{tick:.12g} s"
        yield Stroke([[(at, frame.bottom), (at, frame.top)]], "grid")
        is_end = not figure.is_ground and at > frame.right - 12
        yield Label(text, at, frame.bottom + 12, "tick", is_end=is_end)


def _around(span: Span, length: float) -> Span:
    """Return the span of this `length` that has the same middle as `span`."""
    middle = (span[0] + span[1]) / 2.0
    return middle - length / 2.0, middle + length / 2.0


def _finite(path: Path2D) -> list[Point]:
    return [(x, y) for x, y in path if isfinite(x) and isfinite(y)]


def _least_span(low: float, high: float) -> float:
    """Return the least span of an axis for these values, to hide rounding errors."""
    if low == high:
        return max(abs(high), SMALLEST_SPAN) if high else 1.0
    return max(RELATIVE_SPAN * max(abs(low), abs(high)), SMALLEST_SPAN)
