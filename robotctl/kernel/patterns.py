"""The patterns that a robot drives, and their paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from math import inf, pi, tau
from types import MappingProxyType

from robotctl.kernel.course import MIN_CORNER_M, PLAIN, Course
from robotctl.kernel.figure_eight import figure_eight, figure_eight_parts
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.path import Path
from robotctl.kernel.ranges import Change, bounded, setting
from robotctl.kernel.segments import Arc, Circle, Line, Segment, Turn
from robotctl.kernel.waypoints import waypoint_path


class PatternKind(Enum):
    """The patterns by name."""

    SQUARE = "square"
    CIRCLE = "circle"
    FIGURE_EIGHT = "figure-eight"
    ROUNDED_SQUARE = "rounded-square"
    LINE = "line"
    ARC = "arc"
    TURN = "turn"


class SizeName(Enum):
    """What the size of a pattern is called."""

    SIDE = "side"
    RADIUS = "radius"
    LENGTH = "length"


MIN_SIZE_M, MAX_SIZE_M = 0.1, 100.0
MIN_SPEED_MPS, MAX_SPEED_MPS = 0.01, 10.0


@dataclass(frozen=True, slots=True)
class Pattern:
    """A kind, its size (side, radius or length) [m] and its speed [m/s]; a turn has no size."""

    kind: PatternKind = setting(PatternKind.SQUARE, "pattern of `set-mode moving`", Change.ANY_TIME)
    size_m: float = bounded(
        *(1.0, MIN_SIZE_M, MAX_SIZE_M, "m"),
        "side of a square, radius of a circle or an arc, length of a line",
        Change.ANY_TIME,
    )
    speed_mps: float = bounded(
        *(0.5, MIN_SPEED_MPS, MAX_SPEED_MPS, "m/s"), "speed along the pattern", Change.ANY_TIME
    )

    def refusal(self, course: Course = PLAIN) -> str:
        """Return why this pattern cannot be driven in that way, "" if it can."""
        size_m, speed_mps = self.size_m, self.speed_mps
        if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
            return f"a size of {size_m:g} m: use {MIN_SIZE_M:g} to {MAX_SIZE_M:g} m"
        if not MIN_SPEED_MPS <= speed_mps <= MAX_SPEED_MPS:
            return f"a speed of {speed_mps:g} m/s: use {MIN_SPEED_MPS:g} to {MAX_SPEED_MPS:g} m/s"
        refusal = course.refusal()
        chosen = self._is_rounded(course) and course.corner_m != PLAIN.corner_m
        if not refusal and chosen and 2.0 * course.corner_m > size_m:
            refusal = (
                f"corners of {course.corner_m:g} m do not fit a side of {size_m:g} m: "
                f"use {MIN_CORNER_M:g} to {0.5 * size_m:g} m"
            )
        return refusal

    def _is_rounded(self, course: Course) -> bool:
        return self.kind is PatternKind.ROUNDED_SQUARE and not course.waypoints


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


def _circle_lap(radius_m: float, course: Course) -> Path:
    return Path((Circle(radius_m),), radius_m)


def _figure_eight_lap(radius_m: float, course: Course) -> Path:
    return Path(figure_eight_parts(figure_eight(2.0 * tau * radius_m)), radius_m)


def _line_lap(length_m: float, course: Course) -> Path:
    return _open(Line(ORIGIN, length_m), length_m)


def _arc_lap(radius_m: float, course: Course) -> Path:
    side = 1.0 if course.angle_rad > 0.0 else -1.0
    return _open(Arc(ORIGIN, radius_m, radius_m * abs(course.angle_rad), side), radius_m)


def _turn_lap(size_m: float, course: Course) -> Path:
    side = 1.0 if course.angle_rad > 0.0 else -1.0
    return _open(Turn(ORIGIN, abs(course.angle_rad), side), MIN_SIZE_M)


def _open(segment: Segment, reach_m: float) -> Path:
    return Path((segment,), reach_m, closed=False, end=segment.pose_at(segment.length))


@dataclass(frozen=True, slots=True)
class Shape:
    """The properties of one kind of pattern: the name of its size, a default size, its path.

    A lap of a `closed` shape ends where it begins; of another shape one lap is driven by default.
    `has_corner` and `has_angle` say which part of a `Course` shapes it.
    """

    size_name: SizeName | None
    default_size_m: float
    lap: Callable[[float, Course], Path]
    closed: bool = True
    has_corner: bool = False
    has_angle: bool = False


SHAPES: Mapping[PatternKind, Shape] = MappingProxyType(
    {
        PatternKind.SQUARE: Shape(SizeName.SIDE, 1.0, _square_lap),
        PatternKind.CIRCLE: Shape(SizeName.RADIUS, 0.5, _circle_lap),
        PatternKind.FIGURE_EIGHT: Shape(SizeName.RADIUS, 0.5, _figure_eight_lap),
        PatternKind.ROUNDED_SQUARE: Shape(SizeName.SIDE, 1.0, _rounded_square_lap, has_corner=True),
        PatternKind.LINE: Shape(SizeName.LENGTH, 1.0, _line_lap, closed=False),
        PatternKind.ARC: Shape(SizeName.RADIUS, 0.5, _arc_lap, closed=False, has_angle=True),
        PatternKind.TURN: Shape(None, 1.0, _turn_lap, closed=False, has_angle=True),
    }
)
"""Every kind of pattern; the command line, the configuration and the socket take theirs from it."""


def named(pattern: Pattern, course: Course) -> str:
    """Return what is driven, with its article: "a square", "an arc in reverse"."""
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
    """Return one lap; with `again` a lap of waypoints returns to its start."""
    if course.held is not None:
        return Path((), inf, closed=False)
    if course.waypoints:
        return waypoint_path(course.waypoints, course.corner_m, again=again)
    return SHAPES[pattern.kind].lap(pattern.size_m, course)
