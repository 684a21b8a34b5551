"""A drive along a path: how far the reference has come, and how well the robot follows it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, nan, sqrt

from robotctl.kernel.geometry import Pose
from robotctl.kernel.params import VelocityLimits
from robotctl.kernel.patterns import Path, Pattern, lap_of
from robotctl.kernel.quick_init import quick_init
from robotctl.kernel.tracking import Reference
from robotctl.kernel.types import DriveReport

MAX_LAPS = 100_000

SETTLE_S = 0.6
"""The longest time that the reference waits at a stop for the robot to arrive."""

SETTLED_M, SETTLED_RAD = 0.005, 0.01
"""The largest distance and angle from a stop at which the robot has arrived."""

SPEED_SHARE, ACCEL_SHARE = 0.9, 0.6
"""The share of each limit that the reference uses; the rest is for lag and tracking errors."""


@quick_init
@dataclass(frozen=True, slots=True)
class Progress:
    """How far the reference has come.

    `length` is its position in segment `segment` (m, or rad in a turn) and `speed` its rate per
    second. `settling_s` is how long it has waited at a stop. `closure_m` is the distance of the
    robot from the origin of the drive at the end of the last lap, NaN before that.
    """

    laps: int = 0
    segment: int = 0
    length: float = 0.0
    speed: float = 0.0
    settling_s: float = 0.0
    closure_m: float = nan


@quick_init
@dataclass(frozen=True, slots=True)
class Score:
    """How well the robot followed so far: sums over the odometry samples.

    `error_m` is the distance of the last sample from the reference pose. It is inf when that is
    more than the size of the pattern: a robot that stands still never comes far from the reference
    of a small circle, so a fixed limit alone would not notice it.
    """

    samples: int = 0
    squared_error_sum: float = 0.0
    max_error_m: float = 0.0
    error_m: float = 0.0
    distance_m: float = 0.0


@quick_init
@dataclass(frozen=True, slots=True)
class Drive:
    """A drive of `laps` laps (0: until stopped); its path begins at `origin` in the odom frame."""

    request_id: int
    pattern: Pattern
    laps: int
    origin: Pose
    progress: Progress = Progress()
    score: Score = Score()

    @property
    def path(self) -> Path:
        """The path of one lap, in the frame of `origin`."""
        return lap_of(self.pattern.kind, self.pattern.size_m)

    @property
    def finished(self) -> bool:
        """Whether all laps are driven."""
        return 0 < self.laps <= self.progress.laps

    def reference(self) -> Reference:
        """Return the reference of this moment, in the odom frame."""
        at = self.progress
        segment = self.path.segments[at.segment]
        pose = self.origin.compose(segment.pose_at(at.length))
        if segment.turns:
            return Reference(pose, 0.0, 0.0, at.speed)
        return Reference(pose, at.speed, segment.curvature_at(at.length), 0.0)

    def advance(self, dt_s: float, pose: Pose, limits: VelocityLimits) -> Drive:
        """Return the drive after `dt_s` seconds, with the robot at `pose`."""
        at = self.progress
        segments = self.path.segments
        segment = segments[at.segment]
        if segment.turns:
            top_speed = SPEED_SHARE * limits.angular_rps
            accel = ACCEL_SHARE * limits.angular_accel_rps2
        else:
            top_speed = min(self.pattern.speed_mps, SPEED_SHARE * limits.linear_mps)
            if segment.top_curvature:
                top_speed = min(top_speed, SPEED_SHARE * limits.angular_rps / segment.top_curvature)
            accel = ACCEL_SHARE * limits.linear_accel_mps2
        is_last = at.segment == len(segments) - 1 and at.laps == self.laps - 1
        stops = segment.stops or is_last
        remaining = segment.length - at.length
        speed = min(at.speed + accel * dt_s, top_speed)
        if stops:
            speed = min(speed, sqrt(2.0 * accel * max(remaining, 0.0)))
        step = speed * dt_s
        if step < remaining:
            return self._at(
                Progress(at.laps, at.segment, at.length + step, speed, 0.0, at.closure_m)
            )
        if not stops:
            return self._next_segment(step - remaining, speed, pose)
        settling_s = at.settling_s + dt_s
        if settling_s < SETTLE_S and not self._arrived(segment.pose_at(segment.length), pose):
            return self._at(
                Progress(at.laps, at.segment, segment.length, 0.0, settling_s, at.closure_m)
            )
        return self._next_segment(0.0, 0.0, pose)

    def from_standstill(self) -> Drive:
        """Return the drive with a reference that continues from its place at speed 0."""
        return self._at(replace(self.progress, speed=0.0))

    def measured(self, pose: Pose, moved_m: float) -> Drive:
        """Return the drive with one more sample: the robot moved by `moved_m` and is at `pose`."""
        at, so_far = self.progress, self.score
        path, local = self.path, self.origin.express(pose)
        cross_m = path.distance_to(local, at.segment, at.length)
        error_m = path.segments[at.segment].pose_at(at.length).distance(local)
        score = Score(
            so_far.samples + 1,
            so_far.squared_error_sum + cross_m * cross_m,
            max(so_far.max_error_m, cross_m),
            error_m if error_m <= self.pattern.size_m else inf,
            so_far.distance_m + moved_m,
        )
        return Drive(self.request_id, self.pattern, self.laps, self.origin, at, score)

    def cross_track_m(self, pose: Pose) -> float:
        """Return the distance of a pose from the path, near the reference [m]."""
        at = self.progress
        return self.path.distance_to(self.origin.express(pose), at.segment, at.length)

    def report(self) -> DriveReport:
        """Return how well the path was followed so far."""
        score = self.score
        mean_square = score.squared_error_sum / score.samples if score.samples else 0.0
        return DriveReport(
            self.progress.laps,
            score.distance_m,
            sqrt(mean_square),
            score.max_error_m,
            self.progress.closure_m,
        )

    def _at(self, progress: Progress) -> Drive:
        return Drive(self.request_id, self.pattern, self.laps, self.origin, progress, self.score)

    def _arrived(self, target: Pose, pose: Pose) -> bool:
        error = pose.express(self.origin.compose(target))
        return abs(error.x) < SETTLED_M and abs(error.theta) < SETTLED_RAD

    def _next_segment(self, length: float, speed: float, pose: Pose) -> Drive:
        at = self.progress
        if at.segment + 1 < len(self.path.segments):
            return self._at(Progress(at.laps, at.segment + 1, length, speed, 0.0, at.closure_m))
        return self._at(Progress(at.laps + 1, 0, length, speed, 0.0, self.origin.distance(pose)))
