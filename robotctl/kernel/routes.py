"""Paths and speed plans of the drives that are going on, each made once.

A path follows from pattern and course, a plan from path, speed and limits. A drive asks for them
several times a tick, always with the same objects: so the last answers are found by identity, and
no waypoints are hashed.
"""

from __future__ import annotations

from robotctl.kernel.course import Course
from robotctl.kernel.params import VelocityLimits
from robotctl.kernel.path import Path
from robotctl.kernel.patterns import Pattern, path_of
from robotctl.kernel.speed_plan import Leg, speed_plan

_last_path: list[tuple[Pattern, Course, bool, Path]] = []
_last_plan: list[tuple[Path, float, VelocityLimits, tuple[Leg, ...]]] = []


def path_for(pattern: Pattern, course: Course, laps: int) -> Path:
    """Return the path of one lap. If more than one is driven, a lap returns to its start."""
    again = laps != 1
    for known_pattern, known_course, known_again, path in _last_path:
        if known_pattern is pattern and known_course is course and known_again is again:
            return path
    path = path_of(pattern, course, again=again)
    _last_path[:] = [(pattern, course, again, path)]
    return path


def legs_for(path: Path, speed_mps: float, limits: VelocityLimits) -> tuple[Leg, ...]:
    """Return the speed plan of a path."""
    for known_path, known_mps, known_limits, legs in _last_plan:
        if known_path is path and known_limits is limits and known_mps == speed_mps:
            return legs
    legs = speed_plan(path, speed_mps, limits)
    _last_plan[:] = [(path, speed_mps, limits, legs)]
    return legs
