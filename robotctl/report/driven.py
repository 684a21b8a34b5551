"""Where a robot was, thinned out while it is read."""

from __future__ import annotations

from math import hypot, isfinite
from typing import Final, NamedTuple

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
