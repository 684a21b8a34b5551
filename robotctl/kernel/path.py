"""The segments of a path, in the frame of the drive's first pose."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import tau

from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.trigonometry import atan2, cos, direction, hypot, sin


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line."""

    start: Pose
    length: float
    turns: bool = False
    top_curvature: float = 0.0
    along: tuple[float, float] = field(init=False, repr=False, compare=False)
    """The line's direction, as a unit vector."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "along", direction(self.start.theta))

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m from the start."""
        c, s = self.along
        return Pose(self.start.x + length * c, self.start.y + length * s, self.start.theta)

    def curvature_at(self, length: float) -> float:
        """Return 0."""
        return 0.0

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance [m] from `point` to the nearest point of the line, ends included."""
        c, s = self.along
        dx, dy = point.x - self.start.x, point.y - self.start.y
        along = min(max(c * dx + s * dy, 0.0), self.length)
        return hypot(dx - along * c, dy - along * s)


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn on the spot by `length` rad; `side` is 1.0 to the left, -1.0 to the right."""

    start: Pose
    length: float
    side: float = 1.0
    turns: bool = True
    top_curvature: float = 1.0

    def pose_at(self, length: float) -> Pose:
        """Return the pose when the first `length` rad of the turn are done."""
        return Pose(self.start.x, self.start.y, self.start.theta + self.side * length)

    def curvature_at(self, length: float) -> float:
        """Return `side`: 1 for a turn to the left, -1 to the right (rad of heading per rad)."""
        return self.side

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance [m] from `point` to the place of the turn."""
        return self.start.distance(point)


@dataclass(frozen=True, slots=True)
class Circle:
    """A full circle to the left that begins at the origin."""

    radius: float
    turns: bool = False

    @property
    def length(self) -> float:
        """The circumference [m]."""
        return tau * self.radius

    @property
    def top_curvature(self) -> float:
        """The curvature [1/m]."""
        return 1.0 / self.radius

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the circle."""
        theta = length / self.radius
        c, s = direction(theta)
        return Pose(self.radius * s, self.radius * (1.0 - c), theta)

    def curvature_at(self, length: float) -> float:
        """Return the curvature [1/m]."""
        return 1.0 / self.radius

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance [m] from `point` to the nearest point of the circle."""
        return abs(hypot(point.x, point.y - self.radius) - self.radius)


@dataclass(frozen=True, slots=True)
class Arc:
    """A part of a circle, at most a full one; `side` is 1.0 to the left, -1.0 to the right."""

    start: Pose
    radius: float
    length: float
    side: float = 1.0
    turns: bool = False

    @property
    def top_curvature(self) -> float:
        """The curvature, without its sign [1/m]."""
        return 1.0 / self.radius

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the arc."""
        angle = length / self.radius
        c, s = direction(angle)
        local = Pose(self.radius * s, self.side * self.radius * (1.0 - c), self.side * angle)
        return self.start.compose(local)

    def curvature_at(self, length: float) -> float:
        """Return the curvature [1/m], positive to the left."""
        return self.side / self.radius

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance [m] from `point` to the nearest point of the arc, ends included."""
        local = self.start.express(point)
        ahead, aside = local.x, self.radius - self.side * local.y
        half = 0.5 * self.length / self.radius
        from_middle = wrap_angle(atan2(ahead, aside) - half)
        if abs(from_middle) <= half:
            return abs(hypot(ahead, aside) - self.radius)
        return self.pose_at(self.length if from_middle > 0.0 else 0.0).distance(point)


EIGHT_SWING_RAD = 2.404825557695773
"""The first zero of the Bessel function J0, with which a sine-generated curve closes."""

_PIECES = 720
_PARTS = 8


@dataclass(frozen=True, slots=True)
class FigureEight:
    """A figure eight of `length` m that begins at its crossing, with evenly spaced `points`.

    Its heading is a cosine of the length (the curve of Langbein and Leopold, 1966).
    """

    length: float
    points: tuple[tuple[float, float], ...]

    @property
    def top_curvature(self) -> float:
        """The largest curvature [1/m]."""
        return EIGHT_SWING_RAD * tau / self.length

    def pose_at(self, length: float) -> Pose:
        """Return the pose at `length` m along the figure eight."""
        at = length / self.length * _PIECES
        index = min(int(at), _PIECES - 1)
        share = at - index
        (x0, y0), (x1, y1) = self.points[index], self.points[index + 1]
        heading = EIGHT_SWING_RAD * (1.0 - cos(tau * length / self.length))
        return Pose(x0 + share * (x1 - x0), y0 + share * (y1 - y0), heading)

    def curvature_at(self, length: float) -> float:
        """Return the signed curvature [1/m]."""
        return self.top_curvature * sin(tau * length / self.length)

    def distance_to(self, point: Pose, guess: float) -> float:
        """Return the distance [m] from `point` to the curve, searched near `guess` m along it."""
        near = self.pose_at(guess % self.length).express(point)
        nearest = self.pose_at((guess + near.x) % self.length)
        return abs(nearest.express(point).y)


@dataclass(frozen=True, slots=True)
class FigureEightPart:
    """A part of the figure eight `whole`; it begins at `begin` m along the figure."""

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
        """Return the distance [m] from `point` to `whole`, searched near `guess` m in the part."""
        return self.whole.distance_to(point, self.begin + guess)


def figure_eight(length: float) -> FigureEight:
    """Return a figure eight of `length` m."""
    step = length / _PIECES
    x = y = 0.0
    points = [(x, y)]
    for piece in range(_PIECES):
        heading = EIGHT_SWING_RAD * (1.0 - cos(tau * (piece + 0.5) / _PIECES))
        c, s = direction(heading)
        x, y = x + step * c, y + step * s
        points.append((x, y))
    return FigureEight(length, tuple(points))


def figure_eight_parts(whole: FigureEight) -> tuple[FigureEightPart, ...]:
    """Return the figure eight in equal parts."""
    # In each part, the curvature rises or falls: it is largest at one of the part's ends.
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


Segment = Line | Turn | Circle | Arc | FigureEightPart
"""A piece of a path.

`turns` is true for a turn on the spot, whose length is in rad. `top_curvature` is the largest
curvature [1/m], without its sign; 1 for a turn. `distance_to` searches near the length `guess`.
"""

NEAR_M = 0.05
"""The length of path behind the reference that `distance_to` searches [m]."""

OUTLINE_PIECES = 180
"""The number of poses along all curves of an outline together."""


@dataclass(frozen=True, slots=True)
class Path:
    """The consecutive segments of one lap; a held velocity has none.

    A robot further than `reach_m` from its reference has lost the path.
    """

    segments: tuple[Segment, ...]
    reach_m: float
    closed: bool = True
    end: Pose = ORIGIN

    def distance_to(self, point: Pose, index: int, length: float) -> float:
        """Return the distance [m] from `point` to the path near `length` of segment `index`."""
        segment = self.segments[index]
        if segment.turns:
            return self._distance_to_sides(point, index)
        nearest_m, searched_m = segment.distance_to(point, length), length
        while searched_m < NEAR_M:
            before = self._neighbour(index, -1)
            if before is None or before.turns:
                break
            nearest_m = min(nearest_m, before.distance_to(point, before.length))
            searched_m += before.length
            index -= 1
        return nearest_m

    def _distance_to_sides(self, point: Pose, index: int) -> float:
        """Return the distance [m] to the nearer neighbour of turn `index`, or to a lone turn."""
        before, after = self._neighbour(index, -1), self._neighbour(index, 1)
        distances_m = [] if before is None else [before.distance_to(point, before.length)]
        if after is not None:
            distances_m.append(after.distance_to(point, 0.0))
        return min(distances_m, default=self.segments[index].distance_to(point, 0.0))

    def outline(self) -> tuple[Pose, ...]:
        """Return poses along one lap, to draw it: its corners, and many along its curves."""
        curves = sum(1 for segment in self.segments if _bends(segment))
        pieces_of_curve = max(1, OUTLINE_PIECES // max(1, curves))
        poses = [segment.pose_at(0.0) for segment in self.segments[:1]] or [ORIGIN]
        for segment in self.segments:
            pieces = pieces_of_curve if _bends(segment) else 1
            poses += [segment.pose_at(segment.length * (i + 1) / pieces) for i in range(pieces)]
        return tuple(poses)

    def _neighbour(self, index: int, step: int) -> Segment | None:
        """Return the segment before (-1) or after (1) segment `index`, None beyond an open end."""
        other = index + step
        if not self.closed and not 0 <= other < len(self.segments):
            return None
        return self.segments[other % len(self.segments)]


def _bends(segment: Segment) -> bool:
    return not segment.turns and segment.top_curvature > 0.0
