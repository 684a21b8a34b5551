"""Values over time and places of a robot, thinned out while they are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import hypot, isfinite
from statistics import median
from typing import Final, NamedTuple

COLUMNS: Final = 600
"""Columns of a plot; more than one value in a column cannot be told apart by eye."""

GAP: Final = 10.0
"""A pause of this many times the usual distance of two columns with values breaks the line."""

MAX_VALUE: Final = 1e15
"""Larger values are no measurement; they are left out and counted."""

Sample = tuple[float, float]
"""A time and a value."""


class SeriesColumn(NamedTuple):
    """The values in one column: where they begin and end, and between what they lie."""

    begin_s: float
    first: float
    least: float
    most: float
    end_s: float
    last: float


class Series:
    """Values between the times 0 and `duration_s`; memory and work do not depend on their number.

    `count` is the number of values, and `odd` how many were not finite or too large.
    """

    def __init__(self, duration_s: float) -> None:
        self.count = 0
        self.odd = 0
        self._per_s = COLUMNS / duration_s if duration_s > 0.0 else 0.0
        self._columns: dict[int, SeriesColumn] = {}

    def add(self, t_s: float, value: float) -> None:
        """Take a value; those of one column must come in the order of time."""
        if not (isfinite(value) and abs(value) <= MAX_VALUE):
            self.odd += 1
            return
        self.count += 1
        place = min(max(int(t_s * self._per_s), 0), COLUMNS)
        known = self._columns.get(place)
        if known is None:
            self._columns[place] = SeriesColumn(t_s, value, value, value, t_s, value)
        else:
            least, most = min(known.least, value), max(known.most, value)
            self._columns[place] = SeriesColumn(known.begin_s, known.first, least, most, t_s, value)

    @property
    def columns(self) -> list[SeriesColumn]:
        """The columns with values, in their order."""
        return [self._columns[place] for place in sorted(self._columns)]

    @property
    def least(self) -> float | None:
        """The smallest value, None without any."""
        return min((column.least for column in self._columns.values()), default=None)

    @property
    def most(self) -> float | None:
        """The largest value, None without any."""
        return max((column.most for column in self._columns.values()), default=None)

    def lines(self) -> Iterator[list[Sample]]:
        """Yield the points of each unbroken line."""
        columns = self.columns
        if not columns:
            return
        gaps_s = [after.begin_s - before.end_s for before, after in pairwise(columns)]
        limit_s = max(GAP * median(gaps_s), 4.0 / self._per_s) if gaps_s and self._per_s else 0.0
        line: list[Sample] = []
        for column, gap_s in zip(columns, [*gaps_s, 0.0], strict=True):
            line += _points(column)
            if gap_s > limit_s:
                yield line
                line = []
        yield line


def _points(column: SeriesColumn) -> Sequence[Sample]:
    """Return at most four points that look like all values of a column."""
    if column.begin_s == column.end_s:
        return [(column.begin_s, column.first)]
    middle_s = (column.begin_s + column.end_s) / 2.0
    between = [
        (middle_s, value)
        for value in (column.least, column.most)
        if value not in (column.first, column.last)
    ]
    return [(column.begin_s, column.first), *between, (column.end_s, column.last)]


MAX_PLACES: Final = 3000
"""Above this every second place is removed, and the spacing doubles."""

SPACING_M: Final = 0.002
MAX_COORDINATE_M: Final = 1e6


def is_on_earth(x: float, y: float) -> bool:
    """Return whether a position is finite, and no further away than any robot drives."""
    return isfinite(x) and isfinite(y) and max(abs(x), abs(y)) <= MAX_COORDINATE_M


class DrivenPlace(NamedTuple):
    """A position [m] and when the robot was there [s]."""

    t_s: float
    x: float
    y: float


class ThinnedPath:
    """The places of a robot in the order of time, no two nearer to each other than the spacing."""

    def __init__(self) -> None:
        self.places: list[DrivenPlace] = []
        self._spacing_m = SPACING_M
        self._last: DrivenPlace | None = None

    def add(self, t_s: float, x: float, y: float) -> None:
        """Take a position; one that cannot be true is left out."""
        if not is_on_earth(x, y):
            return
        self._last = DrivenPlace(t_s, x, y)
        if self.places:
            before = self.places[-1]
            if hypot(x - before.x, y - before.y) < self._spacing_m:
                return
        self.places.append(self._last)
        if len(self.places) > MAX_PLACES:
            del self.places[1::2]
            self._spacing_m *= 2.0

    def whole(self) -> list[DrivenPlace]:
        """Return the places, and where the robot was last."""
        ends = self._last is not None and self._last != self.places[-1]
        return [*self.places, self._last] if ends and self._last is not None else self.places
