"""The scale of an axis: from values to pixels, and the round numbers beside it."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Final

RELATIVE_SPAN: Final = 1e-9
SMALLEST_SPAN: Final = 1e-300
"""A shorter axis has no finite scale."""

DIGIT_PX: Final = 7.5
"""The width of a digit beside an axis, at most."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Maps `low` to the pixel `begin` and `high` to the pixel `end`."""

    low: float
    high: float
    begin: float
    end: float

    @property
    def scale(self) -> float:
        """Pixels for each unit."""
        return (self.end - self.begin) / (self.high - self.low)

    def at(self, value: float) -> float:
        """Return the pixel of a value."""
        return self.begin + (value - self.low) * self.scale

    def ticks(self, at_most: int = 8) -> list[float]:
        """Return round numbers within the axis."""
        rough = (self.high - self.low) / at_most
        magnitude = 10.0 ** floor(log10(rough))
        step = next(m for m in (1.0, 2.0, 5.0, 10.0) if m * magnitude >= rough * 0.999) * magnitude
        first, last = ceil(self.low / step - 1e-6), floor(self.high / step + 1e-6)
        return [number * step for number in range(first, last + 1)]


def axis_for(low: float, high: float, begin: float, end: float, *, least_span: float) -> Axis:
    """Return an axis with a little room around both values, and at least `least_span` long."""
    missing = max(least_span - (high - low), 0.0) / 2.0
    low, high = low - missing, high + missing
    room = 0.06 * (high - low)
    return Axis(low - room, high + room, begin, end)


def label(value: float) -> str:
    """Return the text beside a tick."""
    return f"{value:.12g}"


def label_end(text: str, left: float) -> float:
    """Return where the text left of an axis ends: beside it, or further right to have room."""
    return max(left - 6, len(text) * DIGIT_PX)


def least_span_of(low: float, high: float) -> float:
    """Return how long an axis of such values must be, so that rounding is not drawn as a change."""
    if low == high:
        return max(abs(high), SMALLEST_SPAN) if high else 1.0
    return max(RELATIVE_SPAN * max(abs(low), abs(high)), SMALLEST_SPAN)
