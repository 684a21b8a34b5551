"""Obstacles in the path of the present command, from the nearest ranges of a laser scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import atan2, cos, hypot, inf, pi, sin, tau

from robotctl.kernel.ranges import Change, bounded, setting, topic
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.types import Twist

STRAIGHT_RADIUS_M = 1e3
"""An arc of a larger radius counts as a straight line."""

ROUNDING_M = 1e-6
"""More than the computation of a path can be wrong by."""

STANDING_MPS = 1e-3
"""A slower command only turns."""


@dataclass(frozen=True, slots=True)
class ScanParams:
    """A sensor_msgs/LaserScan topic, where the scanner sits, and how large the robot is.

    The robot is a rectangle around its centre. It stops for what is nearer than `stop_distance_m`
    to its front, plus the braking distance, in the area that it will pass.
    """

    use: Use = setting(Use.OFF, "obstacles in a laser scan", Change.START)
    topic: str = topic("scan", "its topic")
    timeout_s: float = bounded(0.5, 0.05, 60.0, "s", "silence after which it is lost", Change.START)
    stop_distance_m: float = bounded(0.3, 0.0, 10.0, "m", "distance at which the robot stops")
    half_width_m: float = bounded(0.25, 0.01, 10.0, "m", "from the centre to a side")
    half_length_m: float = bounded(0.25, 0.01, 10.0, "m", "from the centre to the front")
    x_m: float = bounded(0.0, -10.0, 10.0, "m", "scanner ahead of the centre")
    y_m: float = bounded(0.0, -10.0, 10.0, "m", "scanner left of the centre")
    yaw_rad: float = bounded(0.0, -3.2, 3.2, "rad", "direction of the scanner, to the left")


def distance_ahead(
    sectors: tuple[float, ...], command: Twist, params: ScanParams, reach_m: float
) -> float:
    """Return the distance from the robot to the nearest obstacle in its path [m], inf if none.

    `sectors` are the nearest ranges by direction; an obstacle may be anywhere in its sector. Only
    what is at most `reach_m` away along the path counts. A command of zero looks straight ahead.
    """
    nearest_m, side_m = inf, _side_m(command, params, reach_m)
    for x, y in _points(sectors, params, farthest_m(params, reach_m)):
        if abs(y) <= side_m:
            nearest_m = min(nearest_m, _along_path(x, y, command, params))
    return nearest_m if nearest_m <= reach_m else inf


@lru_cache(maxsize=2)
def free_beside_m(sectors: tuple[float, ...], params: ScanParams, reach_m: float) -> float:
    """Return how far to either side nothing is [m], as far as `reach_m` along any path goes."""
    points = _points(sectors, params, farthest_m(params, reach_m))
    return min([abs(y) for _, y in points], default=inf)


def is_free(free_m: float, command: Twist, params: ScanParams, reach_m: float) -> bool:
    """Return whether nothing can be in the path, as nothing is nearer than `free_m` beside it.

    Where this is False, `distance_ahead` has to tell.
    """
    return _side_m(command, params, reach_m) < free_m


def _side_m(command: Twist, params: ScanParams, reach_m: float) -> float:
    """Return how far to a side the robot can touch something [m]; inf where it turns sharply.

    On an arc of radius r it comes sideways by r * (1 - cos(s / r)) <= s^2 / 2r within the way s.
    """
    way_m = reach_m + params.half_length_m
    radius_m = abs(command.linear / command.angular) if command.angular else inf
    if (abs(command.linear) < STANDING_MPS and command.angular) or radius_m < way_m:
        return inf
    return params.half_width_m + way_m * way_m / (2.0 * radius_m) + ROUNDING_M


def _points(
    sectors: tuple[float, ...], params: ScanParams, far_m: float
) -> list[tuple[float, float]]:
    """Return the places of obstacles that are near: the edges and the middle of each sector."""
    x, y = params.x_m, params.y_m
    return [
        (x + range_m * ahead, y + range_m * left)
        for range_m, rays in zip(sectors, _rays(len(sectors), params.yaw_rad), strict=True)
        if range_m <= far_m
        for ahead, left in rays
    ]


@lru_cache(maxsize=8)
def _rays(count: int, yaw_rad: float) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Return the directions of the edges and the middle of each sector, as cosine and sine."""
    return tuple(
        tuple(
            (cos(angle), sin(angle))
            for angle in (-pi + (number + edge) * tau / count + yaw_rad for edge in (0.0, 0.5, 1.0))
        )
        for number in range(count)
    )


def farthest_m(params: ScanParams, reach_m: float) -> float:
    """Return the largest range at which an obstacle can be `reach_m` away along a path [m]."""
    size_m = params.half_length_m + params.half_width_m
    return reach_m + size_m + abs(params.x_m) + abs(params.y_m)


def _along_path(x: float, y: float, command: Twist, params: ScanParams) -> float:
    """Return how far the robot goes until it touches a point in its own frame, inf if it does not.

    Of the rectangle, the front corners decide in curves: the path is as wide as they need.
    """
    linear, angular = command.linear, command.angular
    if abs(linear) < STANDING_MPS and angular:
        return 0.0 if hypot(x, y) <= hypot(params.half_length_m, params.half_width_m) else inf
    if linear < 0.0:
        x, angular = -x, -angular
        linear = -linear
    if abs(angular) * STRAIGHT_RADIUS_M <= linear or not angular:
        if abs(y) > params.half_width_m or x < 0.0:
            return inf
        return max(x - params.half_length_m, 0.0)
    radius_m = linear / angular
    inner_m = max(abs(radius_m) - params.half_width_m, 0.0)
    outer_m = hypot(abs(radius_m) + params.half_width_m, params.half_length_m)
    if not inner_m <= hypot(x, y - radius_m) <= outer_m:
        return inf
    passed_rad = atan2(x, radius_m - y if radius_m > 0.0 else y - radius_m)
    if passed_rad < 0.0:
        return inf
    return max(passed_rad * abs(radius_m) - params.half_length_m, 0.0)
