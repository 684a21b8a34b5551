"""The patterns that a robot drives, and their paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from itertools import pairwise
from math import inf, pi, tau
from types import MappingProxyType

from robotctl.kernel.course import MIN_CORNER_M, MIN_LEG_M, PLAIN, Course, Frame, Point
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.path import (
    Arc,
    Circle,
    Line,
    Path,
    Segment,
    Turn,
    figure_eight,
    figure_eight_parts,
)
from robotctl.kernel.ranges import Change, bounded, setting
from robotctl.kernel.trigonometry import atan2, hypot, tan

START_M, START_RAD = 0.02, 0.02
"""A path that would begin within this distance and angle of the robot begins at the robot."""

MIN_RADIUS_M, GENTLE_RAD = 0.02, 0.35
"""A corner of a smaller radius and a larger angle than these becomes a turn on the spot."""

STRAIGHT_RAD, SHORTEST_M = 1e-6, 1e-9


def local_points(course: Course, start: Pose) -> tuple[Point, ...]:
    """Return the waypoints of `course` relative to the origin of a drive that begins at `start`."""
    points = course.waypoints
    if course.frame is Frame.ODOM:
        local = [start.express(Pose(x, y)) for x, y in points]
        points = tuple((pose.x, pose.y) for pose in local)
    return tuple((-x, -y) for x, y in points) if course.reverse else points


def waypoint_path(points: tuple[Point, ...], corner_m: float, *, again: bool) -> Path:
    """Return the path from the origin through the points; with `again`, back to the origin.

    Consecutive points in the same place count once. The path has no segments if all points are at
    the origin.
    """
    places = _places(points, again=again)
    legs = [_leg(a, b) for a, b in pairwise(places)]
    segments: list[Segment] = []
    heading, begin_m = 0.0, 0.0
    if legs and abs(legs[0].start.theta) > START_RAD:
        segments.append(_turn(ORIGIN, legs[0].start.theta))
    for number, leg in enumerate(legs):
        heading = leg.start.theta
        following = legs[number + 1] if number + 1 < len(legs) else None
        bend = 0.0 if following is None else wrap_angle(following.start.theta - heading)
        room_m = 0.0 if following is None else _room_m(leg, following, bend, corner_m)
        length_m = leg.length - begin_m - room_m
        if length_m > SHORTEST_M:
            segments.append(Line(leg.pose_at(begin_m), length_m))
        corner = leg.pose_at(leg.length - room_m)
        if room_m:
            radius_m = room_m / tan(0.5 * abs(bend))
            side = 1.0 if bend > 0.0 else -1.0
            segments.append(Arc(corner, radius_m, radius_m * abs(bend), side))
        elif abs(bend) > STRAIGHT_RAD:
            segments.append(_turn(corner, bend))
        begin_m = room_m
    if again and abs(wrap_angle(heading)) > STRAIGHT_RAD:
        segments.append(_turn(Pose(0.0, 0.0, heading), wrap_angle(-heading)))
    reach_m = max(hypot(x, y) for x, y in places)
    last = segments[-1] if segments else None
    end = ORIGIN if again or last is None else last.pose_at(last.length)
    return Path(tuple(segments), reach_m, again, end)


def _places(points: tuple[Point, ...], *, again: bool) -> list[Point]:
    places: list[Point] = [(0.0, 0.0)]
    for number, (x, y) in enumerate(points):
        if hypot(x - places[-1][0], y - places[-1][1]) >= (MIN_LEG_M if number else START_M):
            places.append((x, y))
    if again and hypot(*places[-1]) >= MIN_LEG_M:
        places.append((0.0, 0.0))
    return places


def _leg(begin: Point, end: Point) -> Line:
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    return Line(Pose(*begin, atan2(dy, dx)), hypot(dx, dy))


def _room_m(before: Line, after: Line, bend: float, corner_m: float) -> float:
    """Return the distance [m] between a corner and the ends of its arc, 0 if there is no arc."""
    if abs(bend) <= STRAIGHT_RAD:
        return 0.0
    room_m = min(corner_m, 0.5 * before.length, 0.5 * after.length)
    if abs(bend) > GENTLE_RAD and room_m < MIN_RADIUS_M * tan(0.5 * abs(bend)):
        return 0.0
    return room_m


def _turn(at: Pose, angle: float) -> Turn:
    return Turn(at, abs(angle), 1.0 if angle > 0.0 else -1.0)


class PatternKind(Enum):
    """The kinds of pattern that can be driven, by the names in the configuration."""

    SQUARE = "square"
    CIRCLE = "circle"
    FIGURE_EIGHT = "figure-eight"
    ROUNDED_SQUARE = "rounded-square"
    LINE = "line"
    ARC = "arc"
    TURN = "turn"


class SizeName(Enum):
    """What the size of a pattern measures: the side of a square, a radius, or a length."""

    SIDE = "side"
    RADIUS = "radius"
    LENGTH = "length"


MIN_SIZE_M, MAX_SIZE_M = 0.1, 100.0
MIN_SPEED_MPS, MAX_SPEED_MPS = 0.01, 10.0


@dataclass(frozen=True, slots=True)
class Pattern:
    """A kind of pattern with its size and speed; a turn has no size."""

    kind: PatternKind = setting(PatternKind.SQUARE, "pattern of `set-mode moving`", Change.ANY_TIME)
    size_m: float = bounded(
        1.0,
        MIN_SIZE_M,
        MAX_SIZE_M,
        "m",
        "side of a square, radius of a circle or an arc, length of a line",
        Change.ANY_TIME,
    )
    speed_mps: float = bounded(
        0.5, MIN_SPEED_MPS, MAX_SPEED_MPS, "m/s", "speed along the pattern", Change.ANY_TIME
    )

    def refusal(self, course: Course = PLAIN) -> str:
        """Return why this pattern is not allowed with `course`, or "" if it is allowed."""
        size_m, speed_mps = self.size_m, self.speed_mps
        if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
            return f"a size of {size_m:g} m: use {MIN_SIZE_M:g} to {MAX_SIZE_M:g} m"
        if not MIN_SPEED_MPS <= speed_mps <= MAX_SPEED_MPS:
            return f"a speed of {speed_mps:g} m/s: use {MIN_SPEED_MPS:g} to {MAX_SPEED_MPS:g} m/s"
        refusal = course.refusal()
        is_rounded = self.kind is PatternKind.ROUNDED_SQUARE and not course.waypoints
        chosen = is_rounded and course.corner_m != PLAIN.corner_m
        if not refusal and chosen and 2.0 * course.corner_m > size_m:
            refusal = (
                f"corners of {course.corner_m:g} m do not fit a side of {size_m:g} m: "
                f"use {MIN_CORNER_M:g} to {0.5 * size_m:g} m"
            )
        return refusal


def _square_lap(side_m: float, course: Course) -> Path:
    segments: list[Segment] = []
    corner = ORIGIN
    for _ in range(4):
        side = Line(corner, side_m)
        turn = Turn(side.pose_at(side_m), pi / 2.0)
        corner = turn.pose_at(turn.length)
        segments += [side, turn]
    return Path(tuple(segments), side_m)


def _rounded_square_lap(side_m: float, course: Course) -> Path:
    radius_m = min(course.corner_m, 0.5 * side_m)
    segments: list[Segment] = []
    begin = ORIGIN
    for _ in range(4):
        straight_m = side_m - 2.0 * radius_m
        if straight_m > 0.0:
            segments.append(Line(begin, straight_m))
            begin = segments[-1].pose_at(straight_m)
        corner = Arc(begin, radius_m, 0.5 * pi * radius_m)
        segments.append(corner)
        begin = corner.pose_at(corner.length)
    return Path(tuple(segments), 0.7 * side_m)


def _arc_lap(radius_m: float, course: Course) -> Path:
    side = 1.0 if course.angle_rad > 0.0 else -1.0
    return _open(Arc(ORIGIN, radius_m, radius_m * abs(course.angle_rad), side), radius_m)


def _open(segment: Segment, reach_m: float) -> Path:
    return Path((segment,), reach_m, closed=False, end=segment.pose_at(segment.length))


@dataclass(frozen=True, slots=True)
class Shape:
    """The properties of a kind of pattern; `lap` returns the path of one lap."""

    size_name: SizeName | None
    default_size_m: float
    lap: Callable[[float, Course], Path]
    closed: bool = True
    has_corner: bool = False
    has_angle: bool = False


SHAPES: Mapping[PatternKind, Shape] = MappingProxyType(
    {
        PatternKind.SQUARE: Shape(SizeName.SIDE, 1.0, _square_lap),
        PatternKind.CIRCLE: Shape(
            SizeName.RADIUS, 0.5, lambda radius_m, course: Path((Circle(radius_m),), radius_m)
        ),
        PatternKind.FIGURE_EIGHT: Shape(
            SizeName.RADIUS,
            0.5,
            lambda size_m, course: Path(
                figure_eight_parts(figure_eight(2.0 * tau * size_m)), size_m
            ),
        ),
        PatternKind.ROUNDED_SQUARE: Shape(SizeName.SIDE, 1.0, _rounded_square_lap, has_corner=True),
        PatternKind.LINE: Shape(
            SizeName.LENGTH,
            1.0,
            lambda size_m, course: _open(Line(ORIGIN, size_m), size_m),
            closed=False,
        ),
        PatternKind.ARC: Shape(SizeName.RADIUS, 0.5, _arc_lap, closed=False, has_angle=True),
        PatternKind.TURN: Shape(
            None,
            1.0,
            lambda _, course: _open(_turn(ORIGIN, course.angle_rad), MIN_SIZE_M),
            closed=False,
            has_angle=True,
        ),
    }
)


def named(pattern: Pattern, course: Course) -> str:
    """Return a phrase for the motion, such as "a square" or "an arc in reverse"."""
    if course.held is not None:
        held = course.held
        if held.is_held_to_run:
            return "by hand"
        quiet = f", then nothing for {held.quiet_s:g} s" if held.quiet_s else ""
        what = f"{held.linear_mps:g} m/s and {held.angular_rps:g} rad/s for {held.for_s:g} s"
        return f"{what}{quiet}"
    if course.waypoints:
        what = f"a path of {len(course.waypoints)} points"
    else:
        name = pattern.kind.value
        what = f"{'an' if name[0] in 'aeiou' else 'a'} {name}"
    reverse = " in reverse" if course.reverse else ""
    return f"{what}{reverse}{' in open loop' if course.open_loop else ''}"


@lru_cache(maxsize=16)
def path_of(pattern: Pattern, course: Course, *, again: bool = True) -> Path:
    """Return the path of one lap. With `again`, a path through waypoints returns to its begin."""
    if course.held is not None:
        return Path((), inf, closed=False)
    if course.waypoints:
        return waypoint_path(course.waypoints, course.corner_m, again=again)
    return SHAPES[pattern.kind].lap(pattern.size_m, course)
