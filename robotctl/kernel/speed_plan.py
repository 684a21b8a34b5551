"""The largest speed on each segment of a path within the limits.

Kapania, Subosits and Gerdes (2016) describe the three passes for cars. The limits are curvature,
then backwards braking, then forwards acceleration (in `drive.py`, while the robot drives).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

from robotctl.kernel.course import Course
from robotctl.kernel.params import VelocityLimits
from robotctl.kernel.path import Path, Segment
from robotctl.kernel.patterns import Pattern, path_of

SPEED_SHARE = 0.95
"""The usable share of the velocity limits; the rest is a reserve for catching up."""

ACCEL_SHARE, GENTLE_SHARE = 0.7, 0.9
"""The usable shares of the acceleration limits: in curves; on lines and turns on the spot."""

JOINT_S = 0.09
"""The allowed jump of the turning rate, per `angular_accel_rps2` [s]."""


@dataclass(frozen=True, slots=True)
class Leg:
    """The speed plan of one segment of a path, in m, or in rad for a turn.

    In the last lap, the segment ends at `last_end_speed` instead of `end_speed`.
    """

    length: float
    top_speed: float
    accel: float
    end_speed: float
    last_end_speed: float


def speed_plan(path: Path, speed_mps: float, limits: VelocityLimits) -> tuple[Leg, ...]:
    """Return the planned speeds of each segment; on lines and curves, at most `speed_mps`."""
    segments = path.segments
    tops = [_top_speed(segment, speed_mps, limits) for segment in segments]
    accels = [_accel(segment, limits) for segment in segments]
    joints = [
        _joint_speed(segment, segments[(index + 1) % len(segments)], limits)
        for index, segment in enumerate(segments)
    ]
    last = _end_speeds(path, tops, accels, joints, 0.0)
    end = inf
    for _ in range(2):  # the second round knows the speed at which the lap begins
        laps = _end_speeds(path, tops, accels, joints, end)
        end = _begin_speed(segments[0], tops[0], accels[0], laps[0])
    return tuple(
        Leg(segment.length, tops[index], accels[index], laps[index], last[index])
        for index, segment in enumerate(segments)
    )


def _top_speed(segment: Segment, speed_mps: float, limits: VelocityLimits) -> float:
    if segment.turns:
        return SPEED_SHARE * limits.angular_rps
    speed = min(speed_mps, SPEED_SHARE * limits.linear_mps)
    if segment.top_curvature:
        speed = min(speed, SPEED_SHARE * limits.angular_rps / segment.top_curvature)
    change = abs(segment.curvature_at(segment.length) - segment.curvature_at(0.0))
    if change:
        accel = ACCEL_SHARE * limits.angular_accel_rps2
        speed = min(speed, sqrt(accel * segment.length / change))
    return speed


def _accel(segment: Segment, limits: VelocityLimits) -> float:
    if segment.turns:
        return GENTLE_SHARE * limits.angular_accel_rps2
    if not segment.top_curvature:
        return GENTLE_SHARE * limits.linear_accel_mps2
    turning = limits.angular_accel_rps2 / segment.top_curvature
    return ACCEL_SHARE * min(limits.linear_accel_mps2, turning)


def _joint_speed(before: Segment, after: Segment, limits: VelocityLimits) -> float:
    """Return the largest speed between two segments, 0 for a stop and inf for no limit."""
    if before.turns or after.turns:
        return 0.0
    jump = abs(after.curvature_at(0.0) - before.curvature_at(before.length))
    return JOINT_S * limits.angular_accel_rps2 / jump if jump else inf


def _end_speeds(
    path: Path, tops: list[float], accels: list[float], joints: list[float], end: float
) -> list[float]:
    """Return the speed at the end of each segment, for a lap that ends at speed `end`."""
    speeds = []
    legs = zip(path.segments, tops, accels, joints, strict=True)
    for segment, top, accel, joint in reversed([*legs]):
        speeds.append(min(end, joint, top))
        end = _begin_speed(segment, top, accel, speeds[-1])
    return speeds[::-1]


def _begin_speed(segment: Segment, top: float, accel: float, end: float) -> float:
    return min(top, sqrt(end * end + 2.0 * accel * segment.length))


# Cached by identity: a drive asks several times a tick with the same objects.
_last_path: list[tuple[Pattern, Course, bool, Path]] = []
_last_plan: list[tuple[Path, float, VelocityLimits, tuple[Leg, ...]]] = []


def path_for(pattern: Pattern, course: Course, laps: int) -> Path:
    """Return the path of one lap, cached; waypoints make a closed path unless `laps` is 1."""
    again = laps != 1
    for known_pattern, known_course, known_again, path in _last_path:
        if known_pattern is pattern and known_course is course and known_again is again:
            return path
    path = path_of(pattern, course, again=again)
    _last_path[:] = [(pattern, course, again, path)]
    return path


def legs_for(path: Path, speed_mps: float, limits: VelocityLimits) -> tuple[Leg, ...]:
    """Return the planned speeds of each segment, as `speed_plan` does; the last plan is cached."""
    for known_path, known_mps, known_limits, legs in _last_plan:
        if known_path is path and known_limits is limits and known_mps == speed_mps:
            return legs
    legs = speed_plan(path, speed_mps, limits)
    _last_plan[:] = [(path, speed_mps, limits, legs)]
    return legs
