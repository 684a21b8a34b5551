"""Paths close, and a simulated robot with errors follows them.

Every pattern in closed loop on virtual time, over bases, noise, limits and rates.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import cos, hypot, isclose, pi, sin
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotctl.check.closed_loop import closed_loop
from robotctl.config import Config
from robotctl.kernel.course import Course, Point
from robotctl.kernel.drive import Drive, Progress
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, TrackingParams, VelocityLimits
from robotctl.kernel.patterns import MIN_SIZE_M, SHAPES, Pattern, PatternKind, path_of
from robotctl.kernel.tracking import Reference, follow_blindly, limit, track
from robotctl.kernel.types import DriveRequested, ModeChanged, ModeRequested, Twist
from robotctl.sim import SimParams
from robotctl.testing.kernels import Driven, drive_simulated
from tests.kernel.fed_kernel import lap_of
from tests.support.cases import for_each

CLOSED = [kind for kind in PatternKind if SHAPES[kind].closed]
SIZES = {kind: shape.default_size_m for kind, shape in SHAPES.items()}


def drive(kind: PatternKind, laps: int = 1, rate_hz: float = 50.0, seed: int = 1) -> Driven:
    pattern = Pattern(kind, SIZES[kind], 0.5)
    return drive_simulated(pattern, laps=laps, rate_hz=rate_hz, sim=SimParams(seed=seed))


@for_each("kind", PatternKind)
@for_each(("rate_hz", "seed"), [(50.0, 1), (100.0, 2)])
def test_a_lap_closes_and_stays_near_its_path(kind: PatternKind, rate_hz: float, seed: int) -> None:
    driven = drive(kind, 1, rate_hz, seed)
    report = driven.ended.report
    assert driven.ended.completed
    assert report.laps == 1
    assert report.closure_m <= 0.05
    # A corner of 0.1 m asks all that the limits allow of a base with a lag of 80 ms.
    assert report.cross_track_rms_m <= (0.015 if SHAPES[kind].has_corner else 0.010)
    assert report.cross_track_max_m <= 0.030
    assert isclose(report.distance_m, _lap_length_m(kind), rel_tol=0.08)


def _lap_length_m(kind: PatternKind) -> float:
    return sum(
        segment.length for segment in lap_of(kind, SIZES[kind]).segments if not segment.turns
    )


LIMITS = VelocityLimits()
SPEED_MPS = 0.5


def shortest_side_s(length_m: float, begin_mps: float = 0.0, end_mps: float = 0.0) -> float:
    """Return the shortest time of a straight side between two speeds, at SPEED_MPS at most."""
    changes_mps = [SPEED_MPS - begin_mps, SPEED_MPS - end_mps]
    return length_m / SPEED_MPS + sum(
        change * change / (2.0 * SPEED_MPS * LIMITS.linear_accel_mps2) for change in changes_mps
    )


def shortest_square_s() -> float:
    turn_s = 0.5 * pi / LIMITS.angular_rps + LIMITS.angular_rps / LIMITS.angular_accel_rps2
    return 4.0 * (shortest_side_s(1.0) + turn_s)


def shortest_rounded_square_s() -> float:
    """Return the time with corners of 0.1 m that are entered and left at full turning rate."""
    corner_mps, rest_s = 0.1 * LIMITS.angular_rps, 0.0
    for begin_mps in (0.0, corner_mps, corner_mps, corner_mps):
        rest_s += shortest_side_s(0.8, begin_mps, corner_mps)
    stop_s = corner_mps / (2.0 * LIMITS.linear_accel_mps2)
    return rest_s + 4.0 * 0.5 * pi / LIMITS.angular_rps + stop_s


@for_each(("rate_hz", "seed"), [(50.0, 1), (100.0, 2)])
@for_each(
    ("kind", "shortest_s", "share"),
    [
        (PatternKind.SQUARE, shortest_square_s(), 1.10),
        (PatternKind.ROUNDED_SQUARE, shortest_rounded_square_s(), 1.21),
    ],
)
def test_a_lap_takes_little_more_than_the_shortest_possible_time(
    kind: PatternKind, shortest_s: float, share: float, seed: int, rate_hz: float
) -> None:
    """The rest is the rise of accelerations, the lag of 40 ms, and the share left to catch up."""
    driven = drive_simulated(
        Pattern(kind, 1.0, SPEED_MPS), rate_hz=rate_hz, sim=SimParams(lag_s=0.04, seed=seed)
    )
    assert shortest_s < driven.duration_s <= share * shortest_s


@for_each("kind", [PatternKind.SQUARE, PatternKind.FIGURE_EIGHT])
def test_errors_do_not_add_up_over_laps(kind: PatternKind) -> None:
    one, report = drive(kind).ended.report, drive(kind, laps=4).ended.report
    assert report.laps == 4
    assert report.distance_m == pytest.approx(4 * one.distance_m, rel=0.05, abs=0.05)
    assert report.closure_m <= 0.05
    assert report.cross_track_max_m <= 0.030


@for_each("lag_s", [0.0, 0.2])
@for_each("kind", [PatternKind.SQUARE, PatternKind.ROUNDED_SQUARE])
def test_a_slower_or_a_quicker_robot_closes_its_lap_if_its_lag_is_told(
    kind: PatternKind, lag_s: float
) -> None:
    pattern = Pattern(kind, SIZES[kind], 0.5)
    params = replace(KernelParams(), tracking=TrackingParams(lag_s=lag_s))
    driven = drive_simulated(pattern, sim=SimParams(lag_s=lag_s), params=params)
    assert driven.ended.completed
    assert driven.ended.report.closure_m <= 0.05
    assert driven.ended.report.cross_track_max_m <= (0.075 if SHAPES[kind].has_corner else 0.06)


@for_each("ahead_m", [0.01, 5.0])
def test_the_tracking_law_is_samsons_with_the_curvature_of_the_speed_that_is_commanded(
    ahead_m: float,
) -> None:
    gains, limits = KernelParams().tracking, VelocityLimits()
    reference = Reference(Pose(ahead_m, 0.02, 1.2), 0.4, 0.5, 0.0)
    command = track(reference, ORIGIN, gains, limits)
    linear = min(0.4 * cos(1.2) + gains.k_x * ahead_m, limits.linear_mps)
    sideways = gains.k_y * 0.4 * sin(1.2) / 1.2 * 0.02
    assert isclose(command.linear, linear)
    assert isclose(command.angular, 0.5 * linear + sideways + gains.k_theta * 1.2)


@for_each("kind", PatternKind)
@for_each("lag_s", [0.08, 0.3])
def test_the_smallest_pattern_can_be_driven(kind: PatternKind, lag_s: float) -> None:
    driven = drive_simulated(Pattern(kind, MIN_SIZE_M), laps=2, sim=SimParams(lag_s=lag_s))
    assert driven.ended.completed


@for_each("kind", [PatternKind.CIRCLE, PatternKind.FIGURE_EIGHT])
def test_the_reference_loses_nothing_from_lap_to_lap(kind: PatternKind) -> None:
    drive = Drive(1, Pattern(kind, 0.2), 0, ORIGIN, Progress(speed=0.1))
    length = sum(segment.length for segment in drive.path.segments)
    driven_m = 0.0
    while drive.progress.laps < 3:
        drive = drive.advance(0.02, ORIGIN, VelocityLimits(), 4)
        driven_m += drive.progress.speed * 0.02
    at = drive.progress
    begun_m = sum(segment.length for segment in drive.path.segments[: at.segment])
    assert isclose(driven_m, at.laps * length + begun_m + at.length, rel_tol=1e-9)


@for_each("kind", CLOSED)
@for_each("size_m", [0.1, 1.0, 100.0])
def test_every_path_ends_where_it_begins(kind: PatternKind, size_m: float) -> None:
    path = lap_of(kind, size_m)
    first, last = path.segments[0], path.segments[-1]
    begin, end = first.pose_at(0.0), last.pose_at(last.length)
    assert begin == ORIGIN
    assert hypot(end.x, end.y) <= 1e-4 * size_m
    assert isclose(wrap_angle(end.theta), 0.0, abs_tol=1e-9)


@for_each("kind", PatternKind)
def test_curvature_is_the_change_of_heading_and_heading_that_of_position(kind: PatternKind) -> None:
    step = 1e-5
    for segment in lap_of(kind, 1.0).segments:
        for share in (0.1, 0.37, 0.5, 0.81):
            length = share * segment.length
            here, there = segment.pose_at(length), segment.pose_at(length + step)
            turned = wrap_angle(there.theta - here.theta) / step
            assert isclose(turned, segment.curvature_at(length), rel_tol=1e-3, abs_tol=1e-3)
            assert abs(turned) <= segment.top_curvature * (1.0 + 1e-3)
            if not segment.turns:
                dx, dy = (there.x - here.x) / step, (there.y - here.y) / step
                assert isclose(dx, cos(here.theta), abs_tol=2e-2)
                assert isclose(dy, sin(here.theta), abs_tol=2e-2)


@pytest.mark.parametrize("kind", PatternKind)
@given(share=st.floats(0.02, 0.98), offset_m=st.floats(-0.03, 0.03), lag=st.floats(-0.03, 0.03))
@settings(max_examples=60)
def test_the_cross_track_error_is_the_distance_to_the_path(
    kind: PatternKind, share: float, offset_m: float, lag: float
) -> None:
    path = lap_of(kind, 1.0)
    segment = path.segments[0]
    length = share * segment.length
    beside = segment.pose_at(length).compose(Pose(0.0, offset_m, 0.0))
    guess = min(max(length + lag, 0.0), segment.length)
    assert isclose(path.distance_to(beside, 0, guess), abs(offset_m), abs_tol=1e-3)


def test_past_a_corner_the_overshoot_counts() -> None:
    path = lap_of(PatternKind.SQUARE, 1.0)
    assert isclose(path.distance_to(Pose(1.04, 0.0, 0.0), 0, 1.0), 0.04)
    assert isclose(path.distance_to(Pose(1.04, 0.0, 0.5), 1, 0.5), 0.04)


@for_each("turn", [1, 3, 5, 7])
def test_a_robot_that_turns_may_stand_on_the_side_before_or_after_the_corner(turn: int) -> None:
    path = lap_of(PatternKind.SQUARE, 1.0)
    before, after = path.segments[turn - 1], path.segments[(turn + 1) % 8]
    for on_the_path in (before.pose_at(0.8), after.pose_at(0.2)):
        assert isclose(path.distance_to(on_the_path, turn, 0.5), 0.0, abs_tol=1e-12)


@given(st.floats(-pi, pi), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_composing_undoes_expressing(theta: float, x: float, y: float) -> None:
    frame, pose = Pose(1.0, -2.0, theta), Pose(x, y, 0.5)
    again = frame.compose(frame.express(pose))
    assert isclose(again.x, x, abs_tol=1e-9)
    assert isclose(again.y, y, abs_tol=1e-9)
    assert isclose(again.theta, 0.5, abs_tol=1e-9)


def test_a_step_longer_than_a_whole_lap_ends_the_drive() -> None:
    limits = VelocityLimits(10.0, 20.0, 20.0, 60.0)
    almost_round = Progress(length=0.628, speed=1.8)
    drive = Drive(1, Pattern(PatternKind.CIRCLE, 0.1, 10.0), 2, ORIGIN, almost_round)
    for _ in range(200):
        drive = drive.advance(0.4, ORIGIN, limits, 1)
        if drive.finished:
            break
    assert drive.progress.laps == 2


@for_each(
    ("reference", "command"),
    [
        (Reference(ORIGIN, 0.4, 0.5, 0.0), Twist(0.4, 0.2)),
        (Reference(ORIGIN, 0.0, 0.0, 0.7), Twist(0.0, 0.7)),
    ],
)
def test_open_loop_moves_a_perfect_robot_like_the_reference(
    reference: Reference, command: Twist
) -> None:
    assert follow_blindly(reference) == command


def test_a_ramp_down_with_gentle_limits_is_not_held_against_a_reference_that_stands() -> None:
    limits = VelocityLimits(linear_accel_mps2=0.15)
    config = replace(Config(), kernel=replace(KernelParams(), limits=limits))
    kernel = Kernel(config.kernel)
    asked = (
        DriveRequested(100_000_000, 1, Pattern(PatternKind.SQUARE, 3.0, 0.6), 0, False, "test"),
        ModeRequested(7_000_000_000, 2, Mode.IDLE, "test"),
    )
    stopped = None
    for event, effects in closed_loop(kernel, config.sim, asked, 0):
        changes = [each for each in effects if isinstance(each, ModeChanged)]
        if event.t_ns > 7_000_000_000 and changes:
            (stopped,) = changes
            break
        assert event.t_ns < 60_000_000_000
    assert stopped is not None
    assert (stopped.mode, kernel.state.cause) == (Mode.IDLE, None)


BENDS: tuple[Point, ...] = ((0.0, 0.0), (0.8, 0.0), (1.2, 0.6), (0.4, 1.0))
TURNED = Pose(0.0, 0.0, pi)


@for_each("kind", [*PatternKind, None])
def test_every_pattern_is_driven_near_its_path_within_the_limits_to_its_end_in_time(
    kind: PatternKind | None,
) -> None:
    """A kind of None stands for waypoints; the lag of the base is told, as it should be."""
    draw = Random(f"{kind} 1")
    limits = VelocityLimits(
        draw.uniform(0.2, 1.0), draw.uniform(0.8, 2.0), draw.uniform(0.5, 2.0), draw.uniform(4, 8)
    )
    base = SimParams(
        lag_s=draw.uniform(0.02, 0.06),
        linear_accel_mps2=50.0,
        angular_accel_rps2=100.0,
        actuation_linear_factor=draw.uniform(0.95, 1.05),
        actuation_angular_factor=draw.uniform(0.95, 1.05),
        odometry_rate_hz=draw.choice((50.0, 100.0)),
        seed=draw.randrange(1000),
    )
    exact = replace(
        base,
        lag_s=0.0,
        actuation_linear_factor=1.0,
        actuation_angular_factor=1.0,
        actuation_noise=0.0,
        odometry_noise=0.0,
    )
    reverse, rate_hz = draw.random() < 0.5, draw.choice((50.0, 100.0))
    angle_rad = draw.choice((-1.0, 1.0)) * draw.uniform(0.3, 4.0)
    waypoints = BENDS if kind is None else ()
    course = Course(angle_rad=angle_rad, reverse=reverse, waypoints=waypoints)
    speed_mps = draw.uniform(0.3, 1.0) * min(limits.linear_mps, 0.6)
    pattern = Pattern(kind or PatternKind.SQUARE, draw.uniform(0.5, 1.5), speed_mps)
    params = KernelParams(limits=limits, tracking=TrackingParams(lag_s=base.lag_s))
    driven = drive_simulated(pattern, rate_hz=rate_hz, sim=base, course=course, params=params)
    report = driven.ended.report
    assert driven.ended.completed
    assert report.cross_track_max_m <= 0.03
    assert report.cross_track_rms_m <= 0.01
    for before, command in pairwise(driven.commands):
        assert limit(before, command, 1.0 / rate_hz + 1e-9, limits) == command
    end = path_of(pattern, course, again=False).end
    if reverse:  # a pattern lies behind the robot; waypoints are places, reached rear first
        end = end.compose(TURNED) if kind is None else TURNED.compose(end).compose(TURNED)
    assert driven.pose.distance(end) <= 0.03
    assert abs(wrap_angle(driven.pose.theta - end.theta)) <= 0.04
    params = replace(params, tracking=TrackingParams(lag_s=0.0))
    ideal = drive_simulated(pattern, rate_hz=rate_hz, sim=exact, course=course, params=params)
    assert driven.duration_s <= 1.2 * ideal.duration_s + 0.5
