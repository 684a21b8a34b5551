"""The options of a drive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from math import isfinite, pi

from robotctl.kernel.constants import NS_PER_S

Point = tuple[float, float]

MIN_CORNER_M, MAX_CORNER_M = 0.02, 10.0
MIN_ANGLE_RAD, MAX_ANGLE_RAD = 0.01, 100.0
MAX_POINTS = 2000
MIN_HELD_S, MAX_HELD_S = 0.02, 600.0
MAX_QUIET_S = 5.0

MAX_SILENCE_S = 0.125
"""The largest `Held.for_s` of a hold-to-run velocity."""

MAX_COORDINATE_M = 10_000.0
MIN_LEG_M = 0.001
"""Consecutive points nearer to each other than this count as one."""


class Frame(Enum):
    """The frame of waypoints, either the robot's pose at the start or that of odometry."""

    START = "start"
    ODOM = "odom"


@dataclass(frozen=True, slots=True)
class Held:
    """A velocity for `for_s` seconds, then no command for `quiet_s` seconds.

    `heard_t_ns` is the steady time of a hold-to-run client's last request, None for other
    velocities. The client must repeat its request within `for_s`.
    """

    linear_mps: float
    angular_rps: float
    for_s: float
    heard_t_ns: int | None = None
    quiet_s: float = 0.0

    def refusal(self) -> str:
        """Return why this velocity is not allowed, or "" if it is allowed."""
        if not (isfinite(self.linear_mps) and isfinite(self.angular_rps)):
            return f"a velocity of {self.linear_mps:g} m/s, {self.angular_rps:g} rad/s: use numbers"
        if not MIN_HELD_S <= self.for_s <= MAX_HELD_S:
            return f"a velocity for {self.for_s:g} s: use {MIN_HELD_S:g} to {MAX_HELD_S:g} s"
        if self.is_held_to_run and self.for_s > MAX_SILENCE_S:
            return f"a silence of {self.for_s:g} s: use at most {MAX_SILENCE_S:g} s"
        if not 0.0 <= self.quiet_s <= MAX_QUIET_S:
            return f"no command for {self.quiet_s:g} s: use 0 to {MAX_QUIET_S:g} s"
        return ""

    def begun(self, t_ns: int) -> Held:
        """Return this velocity. If it is hold-to-run, its client counts as heard at `t_ns`."""
        return replace(self, heard_t_ns=t_ns) if self.is_held_to_run else self

    @property
    def is_held_to_run(self) -> bool:
        """Whether the client must repeat its request to keep the robot moving."""
        return self.heard_t_ns is not None

    @property
    def is_let_go(self) -> bool:
        """Whether the hold-to-run client asks for velocity zero."""
        return self.is_held_to_run and not (self.linear_mps or self.angular_rps)

    def is_silent(self, t_ns: int, period_s: float) -> bool:
        """Return whether the hold-to-run client's silence exceeds `for_s` at the next tick."""
        if self.heard_t_ns is None:
            return False
        ahead_s = min(period_s, 0.5 * self.for_s)
        return abs(t_ns - self.heard_t_ns) / NS_PER_S + ahead_s > self.for_s


@dataclass(frozen=True, slots=True)
class Course:
    """The options of a drive.

    - `corner_m`: the corner radius of a rounded square. With waypoints, the curve begins this far
      before a corner; with 0 the robot stops and turns at each point.
    - `angle_rad`: the angle of a turn or an arc, positive to the left.
    - `reverse`: drive rear first. A pattern lies behind the robot; waypoints are unchanged.
    - `open_loop`: drive without feedback from odometry.
    - `waypoints`: points in `frame` [m] to drive through instead of a pattern.
    - `held`: a velocity to command instead of a pattern or waypoints.
    """

    corner_m: float = 0.1
    angle_rad: float = pi / 2.0
    reverse: bool = False
    open_loop: bool = False
    waypoints: tuple[Point, ...] = ()
    frame: Frame = Frame.START
    held: Held | None = None

    def refusal(self) -> str:
        """Return why these options are not allowed, or "" if they are allowed."""
        corner_m, angle_rad = self.corner_m, self.angle_rad
        if self.held is not None:
            return self.held.refusal()
        stops = corner_m == 0.0 and bool(self.waypoints)
        if not (stops or MIN_CORNER_M <= corner_m <= MAX_CORNER_M):
            return f"a corner of {corner_m:g} m: use {MIN_CORNER_M:g} to {MAX_CORNER_M:g} m"
        if not MIN_ANGLE_RAD <= abs(angle_rad) <= MAX_ANGLE_RAD:
            return f"an angle of {angle_rad:g} rad: use {MIN_ANGLE_RAD:g} to {MAX_ANGLE_RAD:g} rad"
        return _waypoints_refusal(self.waypoints) if self.waypoints else ""


PLAIN = Course()


def _waypoints_refusal(points: tuple[Point, ...]) -> str:
    if not 2 <= len(points) <= MAX_POINTS:
        return f"a path of {len(points)} points: use 2 to {MAX_POINTS}"
    for number, (x, y) in enumerate(points, 1):
        if not (isfinite(x) and isfinite(y) and max(abs(x), abs(y)) <= MAX_COORDINATE_M):
            return f"point {number} is {x:g}, {y:g}: use numbers up to {MAX_COORDINATE_M:g} m"
    x0, y0 = points[0]
    if all(abs(x - x0) < MIN_LEG_M and abs(y - y0) < MIN_LEG_M for x, y in points):
        return "all points of the path are the same: use at least two places"
    return ""
