"""Every motion ends in time, however its ticks come: early, late, in bursts or not at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from math import inf, nextafter
from random import Random

import pytest

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import Course, Frame, Held
from robotctl.kernel.drive import SETTLE_S, Progress, advanced
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import (
    BatteryParams,
    KernelParams,
    OdometryParams,
    TrackingParams,
    VelocityLimits,
)
from robotctl.kernel.patterns import Pattern, PatternKind, path_of
from robotctl.kernel.speed_plan import Leg, speed_plan
from robotctl.kernel.types import (
    BatteryReceived,
    DriveEnded,
    DriveRequested,
    Event,
    ModeRequested,
    Odometry,
    OdomReceived,
    PublishTwist,
    Tick,
)
from robotctl.sim import Robot, SimParams
from robotctl.testing.kernels import ready
from tests.support.cases import for_each

BEGIN_NS = NS_PER_S

GAPS: dict[str, Callable[[Random], float]] = {
    "exact": lambda draw: 1.0,
    "a little early and late": lambda draw: draw.gauss(1.0, 0.025),
    "early and late": lambda draw: max(draw.gauss(1.0, 0.4), 1e-6),
    "late": lambda draw: draw.choice((1.0, 1.0, 1.5, 1.9)),
    "missed": lambda draw: draw.choice((1.0, 1.0, 2.0, 4.0)),
    "in bursts": lambda draw: draw.choice((1.0, 2.0, 1e-4, 1e-6)),
    "two at once": lambda draw: draw.choice((1.0, 0.0)),
}
"""The time between two ticks in periods, by what the ticks are."""


@dataclass(frozen=True, slots=True)
class Ran:
    """A motion until it ended: `counted_s` counts at most two periods for each gap."""

    ended: DriveEnded
    seconds: float
    counted_s: float


class Endless(AssertionError):
    """A motion did not end in time."""


def run_unevenly(
    params: KernelParams,
    sim: SimParams,
    begin: Event,
    gaps: str,
    seed: int,
    most_s: float,
    later: Sequence[Event] = (),
) -> Ran:
    """Run a motion to its end; `most_s` is how much of `counted_s` it may take.

    `later` are events that follow, in the order of time.

    Raises:
        Endless: It does not end in time.
        AssertionError: It does not begin.
    """
    draw, kernel, robot = Random(f"{gaps} {seed}"), Kernel(params), Robot(sim)
    period_s, sample_s = 1.0 / params.rate_hz, 1.0 / sim.odometry_rate_hz
    t_s = next_sample_s = next_battery_s = BEGIN_NS / NS_PER_S
    counted_s, requests = 0.0, [begin, *later]
    begun_s: float | None = None

    def give(event: Event) -> DriveEnded | None:
        ended = None
        for effect in kernel.step(event):
            if isinstance(effect, PublishTwist):
                robot.command(effect.twist)
            elif isinstance(effect, DriveEnded):
                ended = effect
        return ended

    while True:
        gap_s = GAPS[gaps](draw) * period_s
        t_s += gap_s
        if begun_s is not None:
            counted_s += min(gap_s, 2.0 * period_s)
        ended = None
        while next_sample_s <= t_s and ended is None:
            robot.advance(sample_s)
            at_ns = round(next_sample_s * NS_PER_S)
            if draw.random() > 0.02 or gaps == "exact":  # else lost
                ended = give(OdomReceived(at_ns, Odometry(robot.odometry, robot.measured, at_ns)))
            next_sample_s += sample_s
        if next_battery_s <= t_s:
            give(BatteryReceived(round(next_battery_s * NS_PER_S), 1.0))
            next_battery_s += 1.0
        t_ns = round(t_s * NS_PER_S)
        while requests and requests[0].t_ns <= t_ns and ended is None:
            ended = give(requests.pop(0))
            if begun_s is None:
                begun_s = t_s
                assert kernel.state.mode is Mode.MOVING, kernel.state.health
        ended = ended or give(Tick(t_ns))
        if ended is not None and begun_s is not None:
            return Ran(ended, t_s - begun_s, counted_s)
        if counted_s > most_s:
            raise Endless(f"{counted_s:.1f} s and not ended: {kernel.state.drive}")


def planned_s(
    pattern: Pattern, course: Course, laps: int, limits: VelocityLimits, rate_hz: float
) -> float:
    """Return how long a drive takes whose robot needs as long as it may at each stop.

    inf stands for a drive of more than 10,000 ticks.
    """
    if course.held is not None:
        return course.held.for_s + course.held.quiet_s
    path = path_of(pattern, course, again=laps != 1)
    legs = speed_plan(path, pattern.speed_mps, limits)
    ticks = max(1, round(limits.accel_rise_s * rate_hz))
    at, seconds = Progress(), 0.0
    for _ in repeat(None, 10_000):
        at, stands = advanced(at, legs, laps, 1.0 / rate_hz, ticks)
        seconds += 1.0 / rate_hz
        if stands:
            seconds += SETTLE_S
            if at.segment + 1 < len(legs):
                at = Progress(at.laps, at.segment + 1)
            else:
                at = Progress(at.laps + 1)
        if at.laps >= laps:
            return seconds
    return inf


def ramp_s(limits: VelocityLimits) -> float:
    """Return how long the longest ramp to zero takes."""
    return max(
        limits.linear_mps / limits.linear_accel_mps2, limits.angular_rps / limits.angular_accel_rps2
    )


ASKED_NS = BEGIN_NS + NS_PER_S
PATIENT = KernelParams(
    max_tick_gap_s=5.0,
    odometry=OdometryParams(timeout_s=10.0, max_jump_m=100.0, max_jump_rad=3.2),
    battery=BatteryParams(timeout_s=600.0),
    tracking=TrackingParams(max_error_m=100.0),
)
"""With time limits that uneven ticks do not reach."""

COURSES = [*PatternKind, "waypoints", "reverse", "open loop", "held"]
RATES_HZ = (5.0, 20.0, 50.0, 100.0)
LONGEST_S = 12.0


def at_or_near(draw: Random, low: float, high: float) -> float:
    """Return a limit of a parameter, or what is next to it, or a value between them."""
    return draw.choice(
        (low, high, nextafter(low, high), nextafter(high, low), draw.uniform(low, high))
    )


def drawn(draw: Random, course: PatternKind | str) -> tuple[Pattern, Course]:
    """Return a motion of a few seconds."""
    size_m = draw.choice((0.1, nextafter(0.1, 1.0), draw.uniform(0.1, 0.5)))
    speed_mps = draw.choice((0.3, draw.uniform(0.1, 2.0)))
    kind = course if isinstance(course, PatternKind) else PatternKind.SQUARE
    pattern = Pattern(kind, size_m, speed_mps)
    if course == "held":
        held = Held(draw.uniform(-1, 1), draw.uniform(-1, 1), draw.uniform(0.02, 2.0))
        return pattern, Course(held=replace(held, quiet_s=draw.choice((0.0, 0.5))))
    angle_rad = draw.choice((-1, 1)) * draw.choice((0.01, draw.uniform(0.01, 4.0)))
    points = tuple((draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3)) for _ in range(3))
    return pattern, Course(
        corner_m=draw.choice((0.02, 0.1)),
        angle_rad=angle_rad,
        reverse=course == "reverse",
        open_loop=course == "open loop",
        waypoints=points if course == "waypoints" else (),
    )


def ends_in_time(course: PatternKind | str, gaps: str, seed: int) -> None:
    draw = Random(f"{course} {gaps} {seed}")
    limits = VelocityLimits(
        at_or_near(draw, 0.2, 10.0),
        at_or_near(draw, 0.8, 20.0),
        at_or_near(draw, 0.5, 20.0),
        at_or_near(draw, 2.0, 60.0),
        draw.choice((0.0, 0.08, 0.5)),
    )
    rate_hz, (pattern, way) = draw.choice(RATES_HZ), drawn(draw, course)
    laps = 1 if course in ("held", "waypoints") else draw.choice((1, 2))
    planned = planned_s(pattern, way, laps, limits, rate_hz)
    if planned > LONGEST_S:
        return
    begin = DriveRequested(ASKED_NS, 1, pattern, laps, False, "operator", course=way)
    is_stopped = draw.random() < 0.2
    stop_ns = ASKED_NS + round(planned * draw.random() * NS_PER_S)
    run = run_unevenly(
        replace(PATIENT, limits=limits, rate_hz=rate_hz),
        SimParams(odometry_rate_hz=draw.choice((10.0, 50.0)), lag_s=draw.choice((0.0, 0.08, 0.3))),
        begin,
        gaps,
        seed,
        1.3 * planned + 2.0 * ramp_s(limits) + 1.0 + 20.0 / rate_hz,
        (ModeRequested(stop_ns, 2, Mode.IDLE.value, "operator"),) if is_stopped else (),
    )
    if way.held is not None and run.ended.completed:
        held_s = way.held.for_s + way.held.quiet_s
        slower = 2.0 if gaps == "missed" else 1.0  # of four periods a ramp takes two
        assert abs(run.seconds - held_s) <= slower * ramp_s(limits) + 8.0 / rate_hz


@for_each("gaps", GAPS)
@for_each("course", COURSES)
def test_every_motion_ends_in_time(course: PatternKind | str, gaps: str) -> None:
    ends_in_time(course, gaps, 1)


@pytest.mark.slow
@pytest.mark.parametrize("gaps", GAPS)
@pytest.mark.parametrize("course", COURSES)
def test_thousands_of_motions_end_in_time(course: PatternKind | str, gaps: str) -> None:
    for seed in range(2, 62):
        ends_in_time(course, gaps, seed)


@for_each(
    ("length", "top_speed", "accel", "rate_hz", "ticks"),
    [
        (3.71117264922738e-05, 0.23639442231581798, 22.85717825363269, 20.0, 9),
        (5.3069440947752715e-06, 5.8165877207185055, 0.8817667274818455, 50.0, 13),
        (1.3046987714167903e-06, 7.971269058340127, 4.612769725004593, 50.0, 4),
    ],
)
def test_a_lead_that_rounding_leaves_just_before_a_stop_is_there(
    length: float, top_speed: float, accel: float, rate_hz: float, ticks: int
) -> None:
    """It once stood there with speed 0 for good, and the robot was MOVING."""
    legs = (Leg(length, top_speed, accel, 0.0, 0.0),)
    at, stands = Progress(), False
    for _ in range(10 + 3 * ticks):
        at, stands = advanced(at, legs, 1, 1.0 / rate_hz, ticks)
        if stands:
            break
    assert stands


@for_each(("frame", "x", "y"), [(Frame.START, 0.0, 0.0), (Frame.ODOM, 2.0, 1.0)])
def test_a_path_whose_points_are_all_where_the_robot_is_is_refused(
    frame: Frame, x: float, y: float
) -> None:
    bench = ready()
    bench.odometry(Pose(x, y, 0.0))
    points = ((x + 0.015, y), (x + 0.0005, y))
    bench.drive(Pattern(), 1, course=Course(waypoints=points, corner_m=0.0, frame=frame))
    assert bench.replies[-1].message == "the robot is at each point of the path already"
    assert bench.state.mode is Mode.IDLE
