"""Obstacles in the path of the present command, from the nearest ranges of a laser scan."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import inf, pi, tau

from robotctl.kernel.params import KernelParams, ScanParams
from robotctl.kernel.state import Scan
from robotctl.kernel.trigonometry import atan2, direction, hypot
from robotctl.kernel.types import Twist

STRAIGHT_RADIUS_M = 1e3
"""An arc of a larger radius counts as a straight line."""

ROUNDING_M = 1e-6
"""A margin that is larger than the rounding errors in the computation of a path."""

STANDING_MPS = 1e-3
"""A slower command with a turning rate counts as a turn on the spot."""


def look_ahead(t_ns: int, sectors: tuple[float, ...], command: Twist, params: KernelParams) -> Scan:
    """Return `sectors` as a Scan, with the distance to the nearest obstacle in `command`'s path."""
    ahead_m = distance_ahead(sectors, command, params.scan, _reach_m(command.linear, params))
    return Scan(t_ns, sectors, min(sectors, default=inf), ahead_m)


def look_again(scan: Scan, command: Twist, params: KernelParams) -> Scan:
    """Return `scan` with the distance to the nearest obstacle in the path of `command`."""
    reach_m, ahead_m = _reach_m(command.linear, params), inf
    if not scan.nearest_m > farthest_m(params.scan, reach_m):  # NaN is looked at, too
        far_m = _reach_m(params.limits.linear_mps, params)
        free_m = free_beside_m(scan.sectors, params.scan, far_m)
        if not is_free(free_m, command, params.scan, reach_m):
            ahead_m = distance_ahead(scan.sectors, command, params.scan, reach_m)
    return scan if ahead_m == scan.ahead_m else replace(scan, ahead_m=ahead_m)


def _reach_m(speed_mps: float, params: KernelParams) -> float:
    """Return the free distance [m] for the stop distance and the braking distance."""
    braking_m = speed_mps * speed_mps / (2.0 * params.limits.linear_accel_mps2)
    return params.scan.stop_distance_m + braking_m


def distance_ahead(
    sectors: tuple[float, ...], command: Twist, params: ScanParams, reach_m: float
) -> float:
    """Return the distance from the robot to the nearest obstacle in its path [m], inf if none.

    `sectors` are the nearest ranges by direction [m]. Obstacles beyond `reach_m` along the path do
    not count. A command of zero has a straight path.
    """
    nearest_m, side_m = inf, _side_m(command, params, reach_m)
    for x, y in _points(sectors, params, farthest_m(params, reach_m)):
        if abs(y) <= side_m:
            nearest_m = min(nearest_m, _along_path(x, y, command, params))
    return nearest_m if nearest_m <= reach_m else inf


@lru_cache(maxsize=2)
def free_beside_m(sectors: tuple[float, ...], params: ScanParams, reach_m: float) -> float:
    """Return the smallest lateral distance |y| [m] of obstacles in reach, or inf if none is."""
    points = _points(sectors, params, farthest_m(params, reach_m))
    return min([abs(y) for _, y in points], default=inf)


def is_free(free_m: float, command: Twist, params: ScanParams, reach_m: float) -> bool:
    """Return whether `command` meets no obstacle if each is at least `free_m` to the side."""
    return _side_m(command, params, reach_m) < free_m


def _side_m(command: Twist, params: ScanParams, reach_m: float) -> float:
    """Return the largest |y| at which the robot can touch something [m]; inf in a sharp turn."""
    way_m = reach_m + params.half_length_m
    radius_m = abs(command.linear / command.angular) if command.angular else inf
    if (abs(command.linear) < STANDING_MPS and command.angular) or radius_m < way_m:
        return inf
    # An arc of radius r and length s leads r * (1 - cos(s / r)) <= s^2 / 2r to the side.
    return params.half_width_m + way_m * way_m / (2.0 * radius_m) + ROUNDING_M


def _points(
    sectors: tuple[float, ...], params: ScanParams, far_m: float
) -> list[tuple[float, float]]:
    """Return the possible obstacles [m], the edges and the middle of each sector within `far_m`."""
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
            direction(angle)
            for angle in (-pi + (number + edge) * tau / count + yaw_rad for edge in (0.0, 0.5, 1.0))
        )
        for number in range(count)
    )


def farthest_m(params: ScanParams, reach_m: float) -> float:
    """Return the range [m] beyond which no scanned obstacle is within `reach_m` along any path."""
    size_m = params.half_length_m + params.half_width_m
    return reach_m + size_m + abs(params.x_m) + abs(params.y_m)


def _along_path(x: float, y: float, command: Twist, params: ScanParams) -> float:
    """Return the distance to the robot's first contact with a point [m], inf if none."""
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
