"""The reference moves along a path: it accelerates, brakes, waits at stops and scores."""

from __future__ import annotations

import random
from dataclasses import replace
from math import cos, inf, isclose, isnan, pi, sin, sqrt

from robotctl.kernel.course import PLAIN
from robotctl.kernel.drive import Drive, Progress, advanced
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.path import Arc, Circle, Line, Path
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.speed_plan import Leg, legs_for, path_for
from tests.kernel.fed_kernel import lap_of
from tests.support.cases import for_each

LIMITS = VelocityLimits(1.0, 2.0, 0.5, 4.0)
FAR = Pose(50.0, 50.0, 0.0)
"""A pose far from every reference: a robot that never arrives."""

SQUARE = Pattern(PatternKind.SQUARE, 1.0, 0.5)
CIRCLE = Pattern(PatternKind.CIRCLE, 0.4, 0.5)
LINE_END = Progress(segment=0, length=1.0)


def drive(pattern: Pattern, at: Progress | None = None, laps: int = 1) -> Drive:
    return Drive(1, pattern, laps, ORIGIN, at or Progress())


def after(driven: Drive, dt_s: float, pose: Pose = FAR) -> Progress:
    """Return the progress `dt_s` later, where accelerations need no time to build up."""
    return driven.advance(dt_s, pose, LIMITS, 1).progress


def test_the_reference_does_not_exceed_its_top_speed_where_it_begins_to_brake() -> None:
    leg = Leg(0.525, 0.5, 0.25, 0.0, 0.0)  # the whole way is what braking in ticks of 0.1 s takes
    at, _ = advanced(Progress(lead_speed=0.5), (leg,), 1, 0.1, 1)
    assert at.lead_speed == 0.5


@for_each(
    ("pose", "arrived"),
    [
        (Pose(1.0, 0.0, 0.0), True),
        (Pose(0.9801, 0.0, 0.0), True),
        (Pose(1.0199, 0.0, 0.0), True),
        (Pose(0.9799, 0.0, 0.0), False),
        (Pose(1.0201, 0.0, 0.0), False),
        (Pose(1.0, 0.0, 0.0299), True),
        (Pose(1.0, 0.0, -0.0299), True),
        (Pose(1.0, 0.0, 0.0301), False),
        (Pose(1.0, 0.0, -0.0301), False),
        (Pose(0.9, 0.0, 0.1), False),
        (Pose(1.0, 0.1, 0.0), True),  # driving on straight ahead would not help
    ],
)
def test_a_robot_has_arrived_within_2_cm_and_3_hundredths_of_a_radian(
    pose: Pose, arrived: bool
) -> None:
    for frame in (ORIGIN, Pose(3.0, -2.0, 1.0)):
        waiting = replace(drive(SQUARE, LINE_END), origin=frame)
        at = after(waiting, 0.02, frame.compose(pose))
        assert (at.segment, at.settling_s) == ((1, 0.0) if arrived else (0, 0.02))


def test_a_robot_waits_at_a_stop_for_at_most_0_6_s() -> None:
    waiting = drive(SQUARE, replace(LINE_END, settling_s=0.57))
    assert after(waiting, 0.02).segment == 0
    assert after(waiting, 0.03).segment == 1


def test_a_lap_of_the_square_has_eight_segments_and_ends_where_the_robot_is() -> None:
    at = Progress(segment=7, length=pi / 2, settling_s=0.3, closure_m=0.5)
    origin = Pose(1.0, 2.0, 0.0)
    ended = replace(drive(SQUARE, at), origin=origin).advance(0.02, origin, LIMITS, 1)
    assert ended.progress == replace(at, laps=1, settling_s=0.0, closure_m=0.0)
    assert ended.finished
    assert isnan(Progress().closure_m)


def test_the_score_sums_up_the_distances_from_the_path() -> None:
    origin = Pose(2.0, 1.0, 0.5)
    scored = replace(drive(SQUARE, Progress(length=0.5)), origin=origin)
    assert scored.report(0).cross_track_rms_m == 0.0
    assert isclose(scored.measured(Pose(2.0, 1.0, 0.6), 0.0).report(0).heading_rms_rad, 0.1)
    for beside_m, behind_m in ((0.03, 0.0), (-0.04, 0.3), (0.0, 0.0)):
        pose = origin.compose(Pose(0.5 - behind_m, beside_m, 0.0))
        scored = scored.measured(pose, 0.25)
        assert isclose(scored.score.error_m, sqrt(beside_m**2 + behind_m**2), abs_tol=1e-9)
    report = scored.report(0)
    assert report.distance_m == 0.75
    assert isclose(report.cross_track_max_m, 0.04)
    assert isclose(report.cross_track_rms_m, sqrt((0.03**2 + 0.04**2) / 3))
    assert report.laps == 0
    assert isnan(report.closure_m)


@for_each(("away_m", "told_m"), [(0.5, 0.5), (0.75, inf)])
def test_a_robot_further_away_than_the_pattern_is_large_is_infinitely_far(
    away_m: float, told_m: float
) -> None:
    pattern = Pattern(PatternKind.SQUARE, 0.5)
    assert drive(pattern).measured(Pose(-away_m, 0.0, 0.0), 0.0).score.error_m == told_m


def test_the_report_tells_the_heading_error_and_the_duration() -> None:
    scored = replace(drive(SQUARE, Progress(length=0.5)), begin_t_ns=1_000_000_000)
    for theta in (0.03, -0.04, 0.0):
        scored = scored.measured(Pose(0.5, 0.0, theta), 0.0)
    report = scored.report(3_500_000_000)
    assert isclose(report.heading_rms_rad, sqrt((0.03**2 + 0.04**2) / 3))
    assert isclose(report.heading_max_rad, 0.04)
    assert report.duration_s == 2.5


# Distances and outlines


@for_each("side", [1.0, -1.0])
def test_the_distance_to_an_arc_is_that_along_its_radius_or_to_its_nearer_end(side: float) -> None:
    quarter = Arc(Pose(1.0, 0.0, 0.0), 2.0, pi, side)
    for x, y, far_m in (
        (1.0 + 3.0 * sin(0.6), 2.0 - 3.0 * cos(0.6), 1.0),
        (1.0 + sin(0.6), 2.0 - cos(0.6), 1.0),
        (0.7, 0.0, 0.3),
        (3.0, 2.4, 0.4),
    ):
        assert isclose(quarter.distance_to(Pose(x, side * y, 0.0), 0.0), far_m, abs_tol=1e-12)


def test_the_outline_of_a_circle_is_a_pose_every_2_degrees_and_leaves_no_curve_out() -> None:
    outline = lap_of(PatternKind.CIRCLE, 0.5).outline()
    assert len(outline) == 181
    for number, pose in enumerate(outline):
        assert isclose(pose.theta, number * pi / 90, abs_tol=1e-9)
    assert len(Path((Circle(5.0),), 5.0).outline()) == 181
    assert len(Path((Circle(0.5),) * 400, 0.5).outline()) == 401


def test_the_path_is_searched_for_5_cm_behind_the_reference_and_no_further() -> None:
    sides = (Line(ORIGIN, 1.0), Line(Pose(1.0, 0.0, pi / 2), 1.0))
    path, behind = Path(sides, 1.0, closed=False), Pose(0.8, 0.0, 0.0)
    assert isclose(path.distance_to(behind, 1, 0.049), 0.0, abs_tol=1e-12)
    assert isclose(path.distance_to(behind, 1, 0.05), 0.2)


def test_a_robot_in_a_corner_is_lost_beyond_one_radian_only() -> None:
    corner = drive(SQUARE, Progress(segment=1))
    for heading_rad, error_m in ((1.0, 0.0), (1.0 + 1e-9, inf)):
        measured = corner.measured(Pose(1.0, 0.0, heading_rad), 0.0)
        assert measured.score.error_m == error_m


@for_each("open_loop", [True, False])
def test_only_in_open_loop_a_corner_is_left_before_the_robot_arrives(open_loop: bool) -> None:
    course = replace(PLAIN, open_loop=open_loop)
    waiting = replace(drive(SQUARE, LINE_END), course=course)
    assert after(waiting, 0.02).segment == int(open_loop)


# The law


@for_each("seed", [4, 7, 64, 79, 149])
def test_no_corner_holds_a_reference_whose_ticks_come_early_and_late(seed: int) -> None:
    """Rounding once left it with a speed of 1e-14 rad/s at a corner, for minutes."""
    path = path_for(Pattern(), PLAIN, 1)
    legs = legs_for(path, Pattern().speed_mps, KernelParams().limits)
    jitter, at, ticks = random.Random(seed), Progress(), 0
    for leg in range(len(legs)):
        at, stands = Progress(segment=leg), False
        while not stands:
            at, stands = advanced(at, legs, 1, jitter.gauss(0.02, 0.0005), 4)
            ticks += 1
            assert ticks < 2000
    assert ticks < 1000


def going(speed: float, segment: int = 0, length: float = 0.0) -> Progress:
    """Return a progress with reference and lead at the same place, at `speed`."""
    return Progress(segment=segment, length=length, speed=speed, lead_speed=speed)


def braking(accel: float, left_m: float, dt_s: float) -> float:
    """Return the speed from which braking in ticks of `dt_s` takes `left_m`, this tick included."""
    half = 0.5 * accel * dt_s
    return sqrt(half * half + 2.0 * accel * left_m) - half


@for_each(("early_m", "brakes"), [(1e-6, False), (-1e-6, True)])
def test_the_reference_brakes_no_tick_earlier_than_it_must(early_m: float, brakes: bool) -> None:
    left_m = 0.4545 * (0.4545 + 0.45 * 0.01) / (2.0 * 0.45) + early_m
    at = after(drive(SQUARE, going(0.45, length=1.0 - left_m)), 0.01)
    assert isclose(at.speed, braking(0.45, left_m, 0.01) if brakes else 0.4545, rel_tol=1e-9)


@for_each(("ahead_m", "stands"), [(2e-9, False), (1.99e-9, True)])
def test_less_than_a_nanometre_before_a_stop_is_rounding(ahead_m: float, stands: bool) -> None:
    """The reference does a nanometre in this tick: one or less is left."""
    at = Progress(ahead=ahead_m, rates=(2e-9,))
    assert advanced(at, (Leg(ahead_m, 1.0, 1.0, 0.0, 0.0),), 1, 1.0, 2)[1] is stands
