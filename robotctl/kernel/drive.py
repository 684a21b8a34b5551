"""A drive along a path, with its progress and its tracking errors.

A point ahead of the reference, the lead, moves by the speed plan. The reference moves at the mean
of the lead's last speeds, which limits the jerk (Biagiotti and Melchiorri 2012).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import fsum, inf, nan, pi, sqrt

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import PLAIN, Course, Held
from robotctl.kernel.geometry import Pose, wrap_angle
from robotctl.kernel.params import TrackingParams, VelocityLimits
from robotctl.kernel.path import Path
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.speed_plan import Leg, legs_for, path_for
from robotctl.kernel.tracking import Reference, follow_blindly, track
from robotctl.kernel.types import DriveReport, Twist, changed

SETTLE_S = 0.6
"""The longest time that the reference waits at a stop for the robot to arrive."""

ARRIVED = 1e-9
"""Smaller distances [m, rad] and speeds [m/s, rad/s] count as 0."""


@dataclass(frozen=True, slots=True)
class Progress:
    """The place and the motion of the reference, the point on the path that the robot follows.

    Lengths are in m; those of a turn in rad, of a held velocity in s. Speeds are per second.

    - `laps`, `segment`, `length`: complete laps, index of the segment, length in it.
    - `speed`, `accel`: the speed and the acceleration of the reference.
    - `ahead`, `lead_speed`: how far the lead, which follows the speed plan, is ahead; its speed.
    - `rates`: the speeds of the lead in the last ticks. The reference moves at their mean.
    - `settling_s`: the time that the reference has waited at a stop.
    - `closure_m`: the robot's distance from the path's end when the last lap ended, or NaN.
    """

    laps: int = 0
    segment: int = 0
    length: float = 0.0
    speed: float = 0.0
    settling_s: float = 0.0
    closure_m: float = nan
    ahead: float = 0.0
    lead_speed: float = 0.0
    rates: tuple[float, ...] = ()
    accel: float = 0.0


def begun(speed: float, ticks: int, dt_s: float, legs: tuple[Leg, ...], *, turns: bool) -> Progress:
    """Return the first progress of a drive that begins at `speed` [m/s].

    It begins at 0 instead if its first segment is a turn (`turns`) or too short for that speed.
    """
    ahead = 0.5 * speed * dt_s * (ticks - 1)
    if turns or speed <= 0.0 or legs[0].length <= ahead:
        return Progress()
    return Progress(speed=speed, ahead=ahead, lead_speed=speed, rates=(speed,) * (ticks - 1))


def advanced(
    at: Progress, legs: tuple[Leg, ...], laps: int, dt_s: float, ticks: int
) -> tuple[Progress, bool]:
    """Return the progress `dt_s` later, and whether the reference has reached a stop by then.

    `laps` is the number of laps to drive, 0 for no end. Speeds are averaged over `ticks` ticks.
    """
    # The place of the lead.
    index, lap, lead, ahead = at.segment, at.laps, at.length + at.ahead, at.ahead
    leg = legs[index]
    end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed
    while lead >= leg.length:
        if end_speed == 0.0:
            ahead -= lead - leg.length
            lead = leg.length
            break
        lead -= leg.length
        index += 1
        if index == len(legs):
            index, lap = 0, lap + 1
        leg = legs[index]
        end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed
    # The motion of the lead.
    left = leg.length - lead
    speed = min(at.lead_speed + leg.accel * dt_s, leg.top_speed)
    # Braking in ticks takes half a tick longer than braking in theory.
    brakes_from, half = end_speed * end_speed + 2.0 * leg.accel * left, 0.5 * leg.accel * dt_s
    if speed * (speed + 2.0 * half) > brakes_from:
        speed = sqrt(half * half + brakes_from) - half
    move = speed * dt_s
    stands = end_speed == 0.0 and move >= left - ARRIVED
    if stands:
        move, speed = left, 0.0
    rates = (*at.rates, move / dt_s)[-ticks:]
    ahead += move
    # The motion of the reference.
    rate = fsum(rates) / ticks
    part = min(rate * dt_s, ahead)
    ahead -= part
    if stands and (ahead < ARRIVED or rate < ARRIVED):
        return Progress(lap, index, leg.length, rate, at.settling_s, at.closure_m), True
    index, lap, length = at.segment, at.laps, at.length + part
    leg = legs[index]
    while length >= leg.length:
        length -= leg.length
        index += 1
        if index == len(legs):
            index, lap = 0, lap + 1
        leg = legs[index]
    accel = (rate - at.speed) / dt_s
    at = Progress(lap, index, length, rate, 0.0, at.closure_m, ahead, speed, rates, accel)
    return at, False


START = Progress()


MAX_LAPS = 100_000

SETTLED_M, SETTLED_RAD = 0.02, 0.03
"""A robot has arrived at a stop if its errors along its heading and in heading are smaller."""

LOST_RAD = 1.0
"""A robot does not follow a turn if its heading is further from the reference than this."""

_TURNED = Pose(0.0, 0.0, pi)


@dataclass(frozen=True, slots=True)
class Score:
    """Sums and maxima of the tracking errors over the odometry samples.

    `error_m` is the last distance from the reference, inf if the robot does not follow the path.
    """

    samples: int = 0
    squared_error_sum: float = 0.0
    max_error_m: float = 0.0
    error_m: float = 0.0
    distance_m: float = 0.0
    squared_heading_sum: float = 0.0
    max_heading_rad: float = 0.0


@dataclass(frozen=True)
class Drive:
    """A drive of `laps` laps (0: until stopped) that began at the steady time `begin_t_ns`.

    The present lap begins at `origin` in the odom frame. In reverse, `origin` is turned by pi.
    """

    request_id: int
    pattern: Pattern
    laps: int
    origin: Pose
    progress: Progress = START
    score: Score = Score()
    course: Course = PLAIN
    begin_t_ns: int = 0

    @property
    def path(self) -> Path:
        """The path of one lap, in the frame of `origin`."""
        return path_for(self.pattern, self.course, self.laps)

    @property
    def finished(self) -> bool:
        """Whether all laps are driven."""
        return 0 < self.laps <= self.progress.laps

    @property
    def is_quiet(self) -> bool:
        """Whether a held velocity is over, and the time without commands (`quiet_s`) has begun."""
        held = self.course.held
        return held is not None and held.quiet_s > 0.0 and self.progress.length >= held.for_s

    def ending(self) -> str:
        """Return the reason for the end of this drive."""
        held = self.course.held
        if held is not None and held.is_held_to_run:
            return "let go" if held.is_let_go else f"not held for {held.for_s * 1e3:g} ms"
        if held is not None:
            return f"drive finished: {held.for_s + held.quiet_s:g} s"
        return f"drive finished: {self.laps} lap{'' if self.laps == 1 else 's'}"

    def reference(self, lag_s: float = 0.0) -> Reference:
        """Return the wanted pose now, in the odom frame, and the wanted motion `lag_s` later."""
        at, segments = self.progress, self.path.segments
        if not segments:
            return Reference(self.origin, 0.0, 0.0, 0.0)
        segment = segments[at.segment]
        pose = self.origin.compose(segment.pose_at(at.length))
        rate = at.speed + at.accel * lag_s
        if segment.turns:
            return Reference(pose, 0.0, 0.0, segment.curvature_at(at.length) * rate)
        length = at.length + at.speed * lag_s
        if length > segment.length:
            following = segments[(at.segment + 1) % len(segments)]
            if following.turns:
                length = segment.length
            else:
                length, segment = min(length - segment.length, following.length), following
        return Reference(pose, rate, segment.curvature_at(length), 0.0)

    def command(self, pose: Pose, gains: TrackingParams, limits: VelocityLimits) -> Twist:
        """Return the held velocity, or a command that brings a robot at `pose` to the reference."""
        if self.course.held is not None:
            return Twist(self.course.held.linear_mps, self.course.held.angular_rps)
        reference = self.reference(gains.lag_s)
        if self.course.open_loop:
            twist = follow_blindly(reference)
        else:
            twist = track(reference, self._heading_of_travel(pose), gains, limits)
        return Twist(-twist.linear, twist.angular) if self.course.reverse else twist

    def begin_at(self, speed_mps: float, limits: VelocityLimits, dt_s: float, ticks: int) -> Drive:
        """Return the drive with a reference that begins at `speed_mps` instead of 0."""
        legs = legs_for(self.path, self.pattern.speed_mps, limits)
        turns = self.path.segments[0].turns
        return self._at(begun(speed_mps, ticks, dt_s, legs, turns=turns))

    def advance(self, dt_s: float, pose: Pose, limits: VelocityLimits, ticks: int) -> Drive:
        """Return the drive after a step of `dt_s`, with the robot at `pose`."""
        if dt_s <= 0.0:
            return self
        if self.course.held is not None:
            return self._held_for(dt_s, self.course.held)
        before = self.progress
        legs = legs_for(self.path, self.pattern.speed_mps, limits)
        at, stands = advanced(before, legs, self.laps, dt_s, ticks)
        if stands:
            settling_s = before.settling_s + dt_s
            if settling_s < SETTLE_S and not self._arrived(at, pose):
                return self._at(replace(at, settling_s=settling_s))
            at = self._after_stop(at)
        if at.laps == before.laps:
            return self._at(at)
        return self._next_lap(at, pose)

    def from_standstill(self) -> Drive:
        """Return the drive with the reference in the same place, at speed 0."""
        at = self.progress
        place = Progress(at.laps, at.segment, at.length, 0.0, at.settling_s, at.closure_m)
        return self._at(place)

    def measured(self, pose: Pose, moved_m: float) -> Drive:
        """Return the drive with an odometry sample in its score: a move by `moved_m` to `pose`."""
        return changed(self, score=self.score_after(self.score, pose, moved_m))

    def score_after(self, so_far: Score, pose: Pose, moved_m: float) -> Score:
        """Return the score `so_far` with a move of `moved_m` to `pose` added."""
        at, path = self.progress, self.path
        if not path.segments:
            return replace(so_far, distance_m=so_far.distance_m + moved_m)
        local = self.origin.express(self._heading_of_travel(pose))
        cross_m = path.distance_to(local, at.segment, at.length)
        segment = path.segments[at.segment]
        wanted = segment.pose_at(at.length)
        error_m = wanted.distance(local)
        heading_rad = abs(wrap_angle(wanted.theta - local.theta))
        # On a small path, no distance exceeds `tracking.max_error_m`.
        lost = error_m > path.reach_m or (segment.turns and heading_rad > LOST_RAD)
        return Score(
            so_far.samples + 1,
            so_far.squared_error_sum + cross_m * cross_m,
            max(so_far.max_error_m, cross_m),
            inf if lost else error_m,
            so_far.distance_m + moved_m,
            so_far.squared_heading_sum + heading_rad * heading_rad,
            max(so_far.max_heading_rad, heading_rad),
        )

    def cross_track_m(self, pose: Pose) -> float:
        """Return the distance [m] from `pose` to the path, searched near the reference."""
        at = self.progress
        if not self.path.segments:
            return 0.0
        return self.path.distance_to(self.origin.express(pose), at.segment, at.length)

    def report(self, t_ns: int) -> DriveReport:
        """Return the drive's laps, distance, duration and tracking errors until `t_ns`."""
        score, count = self.score, max(self.score.samples, 1)
        return DriveReport(
            self.progress.laps,
            score.distance_m,
            sqrt(score.squared_error_sum / count),
            score.max_error_m,
            self.progress.closure_m,
            sqrt(score.squared_heading_sum / count),
            score.max_heading_rad,
            (t_ns - self.begin_t_ns) / NS_PER_S,
        )

    def held_again(self, twist: Twist, t_ns: int) -> Drive:
        """Return the drive with the velocity that its hold-to-run client requested at `t_ns`."""
        assert self.course.held is not None
        held = Held(twist.linear, twist.angular, self.course.held.for_s, t_ns)
        return replace(self, course=replace(self.course, held=held))

    def completed(self) -> Drive:
        """Return the drive with all laps counted as driven."""
        return self._at(replace(self.progress, laps=self.laps))

    def _at(self, progress: Progress) -> Drive:
        return changed(self, progress=progress)

    def _heading_of_travel(self, pose: Pose) -> Pose:
        return pose.compose(_TURNED) if self.course.reverse else pose

    def _arrived(self, at: Progress, pose: Pose) -> bool:
        if self.course.open_loop:
            return True
        target = self.path.segments[at.segment].pose_at(at.length)
        error = self._heading_of_travel(pose).express(self.origin.compose(target))
        return abs(error.x) < SETTLED_M and abs(error.theta) < SETTLED_RAD

    def _held_for(self, dt_s: float, held: Held) -> Drive:
        if held.is_held_to_run:
            return self
        held_s = self.progress.length + dt_s
        is_over = held_s >= held.for_s + held.quiet_s
        return self._at(replace(self.progress, length=held_s, laps=int(is_over)))

    def _after_stop(self, at: Progress) -> Progress:
        if at.segment + 1 < len(self.path.segments):
            return Progress(at.laps, at.segment + 1, closure_m=at.closure_m)
        if at.laps + 1 == self.laps:
            return replace(at, laps=self.laps, settling_s=0.0)
        return Progress(at.laps + 1, closure_m=at.closure_m)

    def _next_lap(self, at: Progress, pose: Pose) -> Drive:
        end = self.origin if self.path.closed else self.origin.compose(self.path.end)
        drive = self._at(replace(at, closure_m=end.distance(pose)))
        return drive if self.path.closed or drive.finished else replace(drive, origin=end)


def origin_of(pose: Pose, course: Course) -> Pose:
    """Return where the path of a drive from `pose` begins: at `pose`, turned by pi in reverse."""
    return pose.compose(_TURNED) if course.reverse else pose
