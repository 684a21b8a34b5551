"""A path through waypoints: straight legs, with an arc or a turn on the spot at each point."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, hypot, tan

from robotctl.kernel.course import MIN_LEG_M, Course, Frame, Point
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.path import Path
from robotctl.kernel.segments import Arc, Line, Segment, Turn

START_M, START_RAD = 0.02, 0.02
"""A path that begins nearer to the robot than this begins at the robot; tracking does the rest."""

MIN_RADIUS_M, GENTLE_RAD = 0.02, 0.35
"""A corner that allows only a smaller radius, and turns by more, is turned on the spot."""

STRAIGHT_RAD = 1e-6


def local_points(course: Course, start: Pose) -> tuple[Point, ...]:
    """Return the waypoints relative to the origin of a drive by a robot at `start`.

    They are places: in reverse the origin looks backwards, so what is ahead of the robot is
    behind the origin.
    """
    points = course.waypoints
    if course.frame is Frame.ODOM:
        local = [start.express(Pose(x, y)) for x, y in points]
        points = tuple((pose.x, pose.y) for pose in local)
    return tuple((-x, -y) for x, y in points) if course.reverse else points


def waypoint_path(points: tuple[Point, ...], corner_m: float, *, again: bool) -> Path:
    """Return the path from the origin through the points; with `again` it returns to its start.

    Points in the same place are one point. Where the first is not at the origin, a leg leads there.
    A path whose points are all at the origin has no segments.
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
        if length_m > 0.0:
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
    """Return how far from the corner its arc begins and ends, 0 for a turn on the spot."""
    if abs(bend) <= STRAIGHT_RAD:
        return 0.0
    room_m = min(corner_m, 0.5 * before.length, 0.5 * after.length)
    if abs(bend) > GENTLE_RAD and room_m < MIN_RADIUS_M * tan(0.5 * abs(bend)):
        return 0.0
    return room_m


def _turn(at: Pose, angle: float) -> Turn:
    return Turn(at, abs(angle), 1.0 if angle > 0.0 else -1.0)
