"""The patterns that a robot drives, and their paths: from length to pose and curvature.

A path is one closed lap of segments, in the frame of the pose where the drive begins. The length of
a line or a curve is in metres, that of a turn on the spot in radians.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from math import cos, hypot, pi, sin, tau
from types import MappingProxyType
from typing import Protocol

from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.ranges import Change, bounded, setting


class PatternKind(Enum):
    """The patterns by name."""

    SQUARE = "square"
    CIRCLE = "circle"
    FIGURE_EIGHT = "figure-eight"


class SizeName(Enum):
    """What the size of a pattern is called."""

    SIDE = "side"
    RADIUS = "radius"


MIN_SIZE_M, MAX_SIZE_M = 0.1, 100.0
MIN_SPEED_MPS, MAX_SPEED_MPS = 0.01, 10.0


@dataclass(frozen=True, slots=True)
class Pattern:
    """A kind, its size (side of the square, radius of the circles) [m] and its speed [m/s]."""

    kind: PatternKind = setting(PatternKind.SQUARE, "pattern of `set-mode moving`", Change.ANY_TIME)
    size_m: float = bounded(
        *(1.0, MIN_SIZE_M, MAX_SIZE_M, "m"),
        "side of the square, radius of circles",
        Change.ANY_TIME,
    )
    speed_mps: float = bounded(
        *(0.5, MIN_SPEED_MPS, MAX_SPEED_MPS, "m/s"), "speed along the pattern", Change.ANY_TIME
    )

    def refusal(self) -> str:
        """Return why this pattern cannot be driven, "" if it can."""
        size_m, speed_mps = self.size_m, self.speed_mps
        if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
            return f"a size of {size_m:g} m: use {MIN_SIZE_M:g} to {MAX_SIZE_M:g} m"
        if not MIN_SPEED_MPS <= speed_mps <= MAX_SPEED_MPS:
            return f"a speed of {speed_mps:g} m/s: use {MIN_SPEED_MPS:g} to {MAX_SPEED_MPS:g} m/s"
        return ""


class Segment(Protocol):
    """A piece of a path.

    `turns` is true for a turn on the spot, whose length is in rad. `stops` is true if the robot
    stands still at the end. `top_curvature` is the largest curvature [1/m], 1 for a turn.
    """

    @property
    def length(self) -> float: ...
    @property
    def turns(self) -> bool: ...
    @property
    def stops(self) -> bool: ...
    @property
    def top_curvature(self) -> float: ...

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` along the segment, in the frame of the drive."""

    def curvature_at(self, length: float) -> float:
        """Return the signed change of heading per length; +1 or -1 for a turn, by its direction."""

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance to the nearest point of the segment [m], searched near `guess`."""


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line; the robot stops at its end."""

    start: Pose
    length: float
    turns: bool = False
    stops: bool = True
    top_curvature: float = 0.0

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m from the start."""
        theta = self.start.theta
        return Pose(self.start.x + length * cos(theta), self.start.y + length * sin(theta), theta)

    def curvature_at(self, length: float) -> float:
        """Return 0: a line is straight."""
        return 0.0

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance to the nearest point of the line, ends included [m]."""
        c, s = cos(self.start.theta), sin(self.start.theta)
        dx, dy = point.x - self.start.x, point.y - self.start.y
        along = min(max(c * dx + s * dy, 0.0), self.length)
        return hypot(dx - along * c, dy - along * s)


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn on the spot to the left; the robot stops at its end."""

    start: Pose
    length: float
    turns: bool = True
    stops: bool = True
    top_curvature: float = 1.0

    def pose_at(self, length: float) -> Pose:
        """Return the pose after turning `length` rad."""
        return Pose(self.start.x, self.start.y, self.start.theta + length)

    def curvature_at(self, length: float) -> float:
        """Return 1: the turn is to the left."""
        return 1.0

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance to the corner [m]."""
        return self.start.distance(point)


@dataclass(frozen=True, slots=True)
class Circle:
    """A full circle to the left that begins at the origin."""

    radius: float
    turns: bool = False
    stops: bool = False

    @property
    def length(self) -> float:
        """The circumference [m]."""
        return tau * self.radius

    @property
    def top_curvature(self) -> float:
        """The curvature, the same everywhere [1/m]."""
        return 1.0 / self.radius

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the circle."""
        theta = length / self.radius
        return Pose(self.radius * sin(theta), self.radius * (1.0 - cos(theta)), theta)

    def curvature_at(self, length: float) -> float:
        """Return the curvature, the same everywhere [1/m]."""
        return 1.0 / self.radius

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance to the circle [m]."""
        return abs(hypot(point.x, point.y - self.radius) - self.radius)


EIGHT_SWING_RAD = 2.404825557695773
"""First zero of the Bessel function J0: with this swing a sine-generated curve closes."""

_EIGHT_PIECES = 720


@dataclass(frozen=True, slots=True)
class FigureEight:
    """A figure eight of `length` m that begins at its crossing; `points` lie evenly along it.

    Its heading is a cosine of the length: the sine-generated curve of Langbein and Leopold (1966).
    So the curvature has no step, and it is 0 at the crossing.
    """

    length: float
    points: tuple[tuple[float, float], ...]
    turns: bool = False
    stops: bool = False

    @property
    def top_curvature(self) -> float:
        """The largest curvature, at the ends of the two loops [1/m]."""
        return EIGHT_SWING_RAD * tau / self.length

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the figure eight."""
        at = length / self.length * _EIGHT_PIECES
        index = min(int(at), _EIGHT_PIECES - 1)
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


def _figure_eight(length: float) -> FigureEight:
    step = length / _EIGHT_PIECES
    x = y = 0.0
    points = [(x, y)]
    for piece in range(_EIGHT_PIECES):
        heading = EIGHT_SWING_RAD * (1.0 - cos(tau * (piece + 0.5) / _EIGHT_PIECES))
        x, y = x + step * cos(heading), y + step * sin(heading)
        points.append((x, y))
    return FigureEight(length, tuple(points))


@dataclass(frozen=True, slots=True)
class Path:
    """One closed lap of segments; it ends at the pose where it begins."""

    segments: tuple[Segment, ...]

    def distance_to(self, point: Pose, index: int, length: float) -> float:
        """Return the distance of `point` from the path near `length` in segment `index` [m]."""
        segment = self.segments[index]
        if not segment.turns:
            return segment.distance_to(point, length)
        # In a corner the robot may stand on the side before it or on the side after it.
        before, after = self.segments[index - 1], self.segments[(index + 1) % len(self.segments)]
        return min(before.distance_to(point, before.length), after.distance_to(point, 0.0))

    def outline(self, pieces_per_curve: int = 180) -> tuple[Pose, ...]:
        """Return the corners of the lap and poses along its curves, to draw it."""
        poses = [self.segments[0].pose_at(0.0)]
        for segment in self.segments:
            pieces = 1 if segment.turns or not segment.top_curvature else pieces_per_curve
            poses += [segment.pose_at(segment.length * (i + 1) / pieces) for i in range(pieces)]
        return tuple(poses)


def _square_lap(side_m: float) -> Path:
    segments: list[Segment] = []
    corner = ORIGIN
    for _ in range(4):
        side = Line(corner, side_m)
        turn = Turn(side.pose_at(side_m), pi / 2.0)
        corner = turn.pose_at(turn.length)
        segments += [side, turn]
    return Path(tuple(segments))


def _circle_lap(radius_m: float) -> Path:
    return Path((Circle(radius_m),))


def _figure_eight_lap(radius_m: float) -> Path:
    return Path((_figure_eight(2.0 * tau * radius_m),))


@dataclass(frozen=True, slots=True)
class Shape:
    """The properties of one kind of pattern: the name of its size, a default size, its path."""

    size_name: SizeName
    default_size_m: float
    lap: Callable[[float], Path]


SHAPES: Mapping[PatternKind, Shape] = MappingProxyType(
    {
        PatternKind.SQUARE: Shape(SizeName.SIDE, 1.0, _square_lap),
        PatternKind.CIRCLE: Shape(SizeName.RADIUS, 0.5, _circle_lap),
        PatternKind.FIGURE_EIGHT: Shape(SizeName.RADIUS, 0.5, _figure_eight_lap),
    }
)
"""Every kind of pattern; the command line, the configuration and the socket take theirs from it."""


@lru_cache(maxsize=16)
def lap_of(kind: PatternKind, size_m: float) -> Path:
    """Return one lap of a pattern."""
    return SHAPES[kind].lap(size_m)
