"""The figure eight, as one curve that is cut into parts of nearly equal curvature."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, tau

from robotctl.kernel.geometry import Pose

EIGHT_SWING_RAD = 2.404825557695773
"""First zero of the Bessel function J0: with this swing a sine-generated curve closes."""

_PIECES = 720
_PARTS = 8


@dataclass(frozen=True, slots=True)
class FigureEight:
    """A figure eight of `length` m that begins at its crossing; `points` lie evenly along it.

    Its heading is a cosine of the length: the sine-generated curve of Langbein and Leopold (1966).
    So the curvature has no step, and it is 0 at the crossing.
    """

    length: float
    points: tuple[tuple[float, float], ...]

    @property
    def top_curvature(self) -> float:
        """The largest curvature, at the ends of the two loops [1/m]."""
        return EIGHT_SWING_RAD * tau / self.length

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the figure eight."""
        at = length / self.length * _PIECES
        index = min(int(at), _PIECES - 1)
        share = at - index
        (x0, y0), (x1, y1) = self.points[index], self.points[index + 1]
        return Pose(x0 + share * (x1 - x0), y0 + share * (y1 - y0), self._heading(length))

    def curvature_at(self, length: float) -> float:
        """Return the signed curvature [1/m]."""
        return self.top_curvature * sin(tau * length / self.length)

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance to the nearest point of the curve near length `guess` [m]."""
        near = self.pose_at(guess % self.length).express(point)
        nearest = self.pose_at((guess + near.x) % self.length)
        return abs(nearest.express(point).y)

    def _heading(self, length: float) -> float:
        return EIGHT_SWING_RAD * (1.0 - cos(tau * length / self.length))


@dataclass(frozen=True, slots=True)
class FigureEightPart:
    """The part of a figure eight that begins at `begin` m along it."""

    whole: FigureEight
    begin: float
    length: float
    top_curvature: float
    turns: bool = False

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the part."""
        return self.whole.pose_at(self.begin + length)

    def curvature_at(self, length: float) -> float:
        """Return the signed curvature [1/m]."""
        return self.whole.curvature_at(self.begin + length)

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance to the nearest point of the whole curve near `guess` [m]."""
        return self.whole.distance_to(point, self.begin + guess)


def figure_eight(length: float) -> FigureEight:
    """Return a figure eight of `length` m."""
    step = length / _PIECES
    x = y = 0.0
    points = [(x, y)]
    for piece in range(_PIECES):
        heading = EIGHT_SWING_RAD * (1.0 - cos(tau * (piece + 0.5) / _PIECES))
        x, y = x + step * cos(heading), y + step * sin(heading)
        points.append((x, y))
    return FigureEight(length, tuple(points))


def figure_eight_parts(whole: FigureEight) -> tuple[FigureEightPart, ...]:
    """Return the figure eight in parts, so that only its bends are driven slowly.

    The curvature rises or falls throughout a part, so it is largest at one of its ends.
    """
    step = whole.length / _PARTS
    begins = [step * number for number in range(_PARTS)]
    return tuple(
        FigureEightPart(
            whole,
            begin,
            step,
            max(abs(whole.curvature_at(begin)), abs(whole.curvature_at(begin + step))),
        )
        for begin in begins
    )
