"""The reference moves along a path: it accelerates, brakes, waits at stops and scores."""

from __future__ import annotations

import random
from dataclasses import replace
from math import cos, hypot, inf, isclose, isnan, pi, sin, sqrt

from robotctl.kernel.course import PLAIN
from robotctl.kernel.drive import Drive, Progress, advanced, begun
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.path import Arc, Circle, FigureEight, Line, Path, Turn, figure_eight
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.speed_plan import Leg, legs_for, path_for, speed_plan
from robotctl.kernel.tracking import Reference, track
from tests.kernel.fed_kernel import lap_of
from tests.support.cases import for_each

LIMITS = VelocityLimits(1.0, 2.0, 0.5, 4.0)
FAR = Pose(50.0, 50.0, 0.0)
"""A pose far from every reference: a robot that never arrives."""

SQUARE = Pattern(PatternKind.SQUARE, 1.0, 0.5)
CIRCLE = Pattern(PatternKind.CIRCLE, 0.4, 0.5)
LINE_END = Progress(segment=0, length=1.0)
TURN_END = Progress(segment=1, length=pi / 2)


def drive(pattern: Pattern, at: Progress | None = None, laps: int = 1) -> Drive:
    return Drive(1, pattern, laps, ORIGIN, at or Progress())


def going(speed: float, segment: int = 0, length: float = 0.0) -> Progress:
    """Return a progress with reference and lead at the same place, at `speed`."""
    return Progress(segment=segment, length=length, speed=speed, lead_speed=speed)


def after(driven: Drive, dt_s: float, pose: Pose = FAR) -> Progress:
    """Return the progress `dt_s` later, where accelerations need no time to build up."""
    return driven.advance(dt_s, pose, LIMITS, 1).progress


def braking(accel: float, left_m: float, dt_s: float) -> float:
    """Return the speed from which braking in ticks of `dt_s` takes `left_m`, this tick included."""
    half = 0.5 * accel * dt_s
    return sqrt(half * half + 2.0 * accel * left_m) - half


def test_the_reference_speeds_up_with_90_percent_of_the_limit_and_with_70_in_curves() -> None:
    line = after(drive(SQUARE, Progress(length=0.1, settling_s=0.2)), 0.1)
    assert line.settling_s == 0.0
    assert isclose(line.speed, 0.9 * 0.5 * 0.1)
    assert isclose(line.accel, 0.9 * 0.5)
    assert isclose(after(drive(SQUARE, going(0.2)), 0.1).accel, 0.9 * 0.5)
    assert isclose(line.length, 0.1 + line.speed * 0.1)
    turn = after(drive(SQUARE, Progress(segment=1, length=0.1)), 0.1)
    assert isclose(turn.speed, 0.9 * 4.0 * 0.1)
    assert isclose(turn.length, 0.1 + turn.speed * 0.1)
    assert isclose(after(drive(CIRCLE), 0.1).speed, 0.7 * 0.5 * 0.1)


@for_each(
    ("pattern", "segment", "top_speed"),
    [
        (SQUARE, 0, 0.5),
        (Pattern(PatternKind.SQUARE, 9.0, 5.0), 0, 0.95 * 1.0),
        (SQUARE, 1, 0.95 * 2.0),
        (CIRCLE, 0, 0.5),
        (Pattern(PatternKind.CIRCLE, 0.2, 0.5), 0, 0.95 * 2.0 * 0.2),
    ],
)
def test_the_top_speed_is_the_patterns_or_95_percent_of_a_limit(
    pattern: Pattern, segment: int, top_speed: float
) -> None:
    fast = drive(pattern, going(1.9, segment), laps=0)
    assert isclose(after(fast, 0.01).speed, top_speed)


def test_the_reference_brakes_so_that_it_stands_at_the_stop() -> None:
    """The reference has the speed from which the remaining distance is just enough to brake."""
    for length in (0.5, 0.9, 0.99):
        at = after(drive(SQUARE, going(0.45, length=length)), 0.01)
        assert isclose(at.speed, min(0.4545, braking(0.45, 1.0 - length, 0.01)))
        assert isclose(at.length, length + 0.01 * at.speed)


@for_each(("early_m", "brakes"), [(1e-6, False), (-1e-6, True)])
def test_the_reference_brakes_no_tick_earlier_than_it_must(early_m: float, brakes: bool) -> None:
    left_m = 0.4545 * (0.4545 + 0.45 * 0.01) / (2.0 * 0.45) + early_m
    at = after(drive(SQUARE, going(0.45, length=1.0 - left_m)), 0.01)
    assert isclose(at.speed, braking(0.45, left_m, 0.01) if brakes else 0.4545, rel_tol=1e-9)


def test_the_reference_does_not_exceed_its_top_speed_where_it_begins_to_brake() -> None:
    leg = Leg(0.525, 0.5, 0.25, 0.0, 0.0)  # the whole way is what braking in ticks of 0.1 s takes
    at, _ = advanced(Progress(lead_speed=0.5), (leg,), 1, 0.1, 1)
    assert at.lead_speed == 0.5


@for_each(("ahead_m", "stands"), [(2e-9, False), (1.99e-9, True)])
def test_less_than_a_nanometre_before_a_stop_is_rounding(ahead_m: float, stands: bool) -> None:
    """The reference does a nanometre in this tick: one or less is left."""
    at = Progress(ahead=ahead_m, rates=(2e-9,))
    assert advanced(at, (Leg(ahead_m, 1.0, 1.0, 0.0, 0.0),), 1, 1.0, 2)[1] is stands


def test_a_circle_too_small_to_brake_in_brakes_as_the_last_lap_begins() -> None:
    pattern, limits = Pattern(PatternKind.CIRCLE, 0.1, 0.6), VelocityLimits(1.0, 9.0, 0.4, 9.0)
    crossing = going(0.6, length=Circle(0.1).length + 0.002)

    def speed(laps: int, at: Progress = crossing) -> float:
        return drive(pattern, at, laps).advance(0.01, FAR, limits, 1).progress.speed

    assert speed(0) == speed(3) == 0.6
    assert speed(0, replace(crossing, laps=5)) == 0.6
    assert speed(2) < 0.6
    assert speed(3, replace(crossing, laps=1)) == speed(2)


def test_what_a_step_has_left_at_a_flowing_end_is_driven_on_the_next_lap() -> None:
    ended = drive(CIRCLE, going(0.45, length=Circle(0.4).length - 0.001), laps=2)
    at = after(ended, 0.01, Pose(0.03, 0.04, 0.0))
    assert (at.laps, at.segment) == (1, 0)
    assert isclose(at.length, 0.4535 * 0.01 - 0.001)
    assert isclose(at.speed, 0.4535)
    assert isclose(at.closure_m, 0.05)


@for_each("at", [LINE_END, TURN_END])
def test_the_reference_waits_at_a_stop_and_counts_the_time(at: Progress) -> None:
    waiting = after(drive(SQUARE, replace(at, settling_s=0.1)), 0.02)
    assert (waiting.segment, waiting.length, waiting.speed) == (at.segment, at.length, 0.0)
    assert waiting.settling_s == 0.1 + 0.02


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


@for_each(("behind_m", "arrived"), [(0.02, False), (0.0199, True)])
def test_2_cm_before_a_stop_is_too_far(behind_m: float, arrived: bool) -> None:
    waiting = replace(drive(SQUARE, LINE_END), origin=Pose(-1.0, 0.0, 0.0))
    assert after(waiting, 0.02, Pose(-behind_m, 0.0, 0.0)).segment == int(arrived)


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


@for_each("laps", [0, 2, 3])
def test_a_square_begins_again_until_its_laps_are_driven(laps: int) -> None:
    at = Progress(segment=7, length=pi / 2, settling_s=9.0)
    later = after(drive(SQUARE, at, laps=laps), 0.02)
    assert (later.laps, later.segment, later.length, later.settling_s) == (1, 0, 0.0, 0.0)


@for_each(
    ("laps", "driven", "finished"),
    [(0, 9, False), (2, 1, False), (2, 2, True), (1, 0, False), (1, 2, True)],
)
def test_a_drive_is_finished_after_its_laps(laps: int, driven: int, finished: bool) -> None:
    assert drive(SQUARE, Progress(laps=driven), laps).finished is finished


def test_the_figures_of_the_last_lap_stay_during_the_next() -> None:
    for at in (Progress(length=0.3), LINE_END, replace(LINE_END, settling_s=9.0)):
        later = after(drive(SQUARE, replace(at, laps=1, closure_m=0.02), laps=3), 0.02)
        assert (later.laps, later.closure_m) == (1, 0.02)


def test_a_step_of_no_time_changes_nothing() -> None:
    begun = drive(SQUARE, going(0.3, length=0.2))
    for dt_s in (0.0, -0.02):
        assert begun.advance(dt_s, FAR, LIMITS, 4) is begun


def test_the_reference_tells_a_speed_ahead_or_a_rate_of_turning() -> None:
    origin = Pose(1.0, 0.0, pi / 2)
    line = replace(drive(SQUARE, Progress(length=0.25, speed=0.3)), origin=origin).reference()
    assert (line.linear, line.curvature, line.turning) == (0.3, 0.0, 0.0)
    assert isclose(line.pose.y, 0.25)
    assert isclose(line.pose.x, 1.0)
    turn = drive(SQUARE, Progress(segment=1, length=0.25, speed=0.3)).reference()
    assert turn == Reference(Pose(1.0, 0.0, 0.25), 0.0, 0.0, 0.3)
    circle = drive(CIRCLE, Progress(speed=0.3)).reference()
    assert circle == Reference(ORIGIN, 0.3, 2.5, 0.0)


def test_a_drive_from_standstill_keeps_its_place() -> None:
    at = Progress(1, 2, 0.3, 0.4, 0.1, 0.02)
    at = replace(at, ahead=0.02, lead_speed=0.4, rates=(0.3, 0.4), accel=0.5)
    stands = drive(SQUARE, at).from_standstill().progress
    assert stands == Progress(1, 2, 0.3, 0.0, 0.1, 0.02)


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


def whole_eight(radius_m: float) -> FigureEight:
    return figure_eight(4.0 * pi * radius_m)


def test_the_distance_to_a_line_is_that_to_its_nearest_place_or_end() -> None:
    line = Line(Pose(2.0, 1.0, 0.7), 1.5)
    for along_m, beside_m, far_m in (
        (0.5, 0.2, 0.2),
        (0.0, -0.3, 0.3),
        (1.5, -0.3, 0.3),
        (-0.3, 0.4, 0.5),
        (1.8, -0.4, 0.5),
    ):
        point = line.start.compose(Pose(along_m, beside_m, 0.0))
        assert isclose(line.distance_to(point, 0.0), far_m)


def test_the_distance_to_a_turn_is_that_to_its_corner() -> None:
    turn = Turn(Pose(1.0, 1.0, 0.0), pi / 2)
    assert turn.distance_to(Pose(4.0, 5.0, 2.0), 0.5) == 5.0
    assert turn.top_curvature == turn.curvature_at(0.5) == 1.0


@for_each("from_centre_m", [0.0, 1.5, 2.0, 2.5])
def test_the_distance_to_a_circle_is_that_along_its_radius(from_centre_m: float) -> None:
    for angle in (0.0, 1.0, 4.0):
        point = Pose(from_centre_m * cos(angle), 2.0 + from_centre_m * sin(angle), 0.0)
        assert isclose(Circle(2.0).distance_to(point, 0.0), abs(from_centre_m - 2.0), abs_tol=1e-12)


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


def test_the_outline_of_a_square_is_its_corners() -> None:
    outline = lap_of(PatternKind.SQUARE, 2.0).outline()
    assert outline[0] == ORIGIN
    assert len(outline) == 9
    corners = [(0, 0), (2, 0), (2, 0), (2, 2), (2, 2), (0, 2), (0, 2), (0, 0), (0, 0)]
    for pose, (x, y) in zip(outline, corners, strict=True):
        assert isclose(pose.x, x, abs_tol=1e-9)
        assert isclose(pose.y, y, abs_tol=1e-9)


def test_the_outline_of_a_circle_is_a_pose_every_2_degrees_and_leaves_no_curve_out() -> None:
    outline = lap_of(PatternKind.CIRCLE, 0.5).outline()
    assert len(outline) == 181
    for number, pose in enumerate(outline):
        assert isclose(pose.theta, number * pi / 90, abs_tol=1e-9)
    assert len(Path((Circle(5.0),), 5.0).outline()) == 181
    assert len(Path((Circle(0.5),) * 400, 0.5).outline()) == 401


def test_an_outline_begins_where_the_path_begins_and_is_one_place_without_a_path() -> None:
    begin = Pose(1.0, 2.0, 0.1)
    assert Path((Line(begin, 1.0),), 1.0).outline()[0] == begin
    assert Path((), 1.0).outline() == (ORIGIN,)


def test_behind_a_corner_of_an_open_path_the_side_before_it_counts() -> None:
    sides = (Line(ORIGIN, 1.0), Line(Pose(1.0, 0.0, pi / 2), 1.0))
    path = Path(sides, 1.0, closed=False)
    assert isclose(path.distance_to(Pose(0.9, -0.01, 0.0), 1, 0.02), 0.01)
    assert isclose(path.distance_to(Pose(-0.3, 0.0, 0.0), 0, 0.02), 0.3)


def test_an_open_path_does_not_go_on_at_its_other_end() -> None:
    sides = (Line(ORIGIN, 1.0), Line(Pose(1.0, 0.0, pi / 2), 1.0), Line(Pose(1.0, 1.0, pi), 1.0))
    path = Path(sides, 1.0, closed=False)
    assert isclose(path.distance_to(Pose(-0.3, 1.0, 0.0), 0, 0.02), hypot(0.3, 1.0))
    path = Path((*sides[:2], Turn(Pose(1.0, 1.0, pi / 2), pi / 2)), 1.0, closed=False)
    assert isclose(path.distance_to(Pose(0.5, 0.0, 0.0), 2, 0.1), 0.5)


def test_in_a_corner_beside_a_curve_the_curve_counts_from_its_nearer_end() -> None:
    before, part = lap_of(PatternKind.FIGURE_EIGHT, 0.5).segments[1:3]
    turn = Turn(part.pose_at(0.0), 0.5)
    beside = part.pose_at(0.0).compose(Pose(0.0, 0.1, 0.0))
    for path in (Path((turn, part), 0.5, closed=False), Path((before, turn), 0.5, closed=False)):
        index = path.segments.index(turn)
        assert isclose(path.distance_to(beside, index, 0.0), 0.1, abs_tol=1e-9)


def test_the_path_is_searched_for_5_cm_behind_the_reference_and_no_further() -> None:
    sides = (Line(ORIGIN, 1.0), Line(Pose(1.0, 0.0, pi / 2), 1.0))
    path, behind = Path(sides, 1.0, closed=False), Pose(0.8, 0.0, 0.0)
    assert isclose(path.distance_to(behind, 1, 0.049), 0.0, abs_tol=1e-12)
    assert isclose(path.distance_to(behind, 1, 0.05), 0.2)


def test_the_path_behind_the_reference_may_have_short_segments() -> None:
    steps = (Line(ORIGIN, 0.02), Line(Pose(0.02, 0.0, pi / 2), 0.02), Line(Pose(0.02, 0.02), 1.0))
    path = Path(steps, 1.0, closed=False)
    assert isclose(path.distance_to(Pose(0.01, -0.003), 2, 0.01), 0.003)


def test_in_a_corner_of_an_open_path_the_side_after_it_counts() -> None:
    turn = Turn(Pose(1.0, 0.0, 0.0), pi / 2)
    sides = (Line(ORIGIN, 1.0), turn, Line(Pose(1.0, 0.0, pi / 2), 1.0))
    path = Path(sides, 1.0, closed=False)
    assert isclose(path.distance_to(Pose(1.1, 0.5, 0.0), 1, 0.0), 0.1)


def test_a_robot_in_a_corner_is_lost_beyond_one_radian_only() -> None:
    corner = drive(SQUARE, Progress(segment=1))
    for heading_rad, error_m in ((1.0, 0.0), (1.0 + 1e-9, inf)):
        measured = corner.measured(Pose(1.0, 0.0, heading_rad), 0.0)
        assert measured.score.error_m == error_m


def test_the_reference_of_a_slow_base_is_in_the_next_segment_already() -> None:
    pattern = Pattern(PatternKind.ROUNDED_SQUARE, 1.0, 0.5)
    line, arc = lap_of(PatternKind.ROUNDED_SQUARE, 1.0).segments[:2]
    driven = drive(pattern, going(0.5, length=line.length - 0.01))
    assert driven.reference().curvature == 0.0
    assert driven.reference(lag_s=0.04).curvature == arc.curvature_at(0.01) > 0.0


def test_the_speed_for_a_slow_base_is_that_of_a_reference_that_goes_on_accelerating() -> None:
    at = Progress(length=0.2, speed=0.3, accel=0.5)
    assert isclose(drive(SQUARE, at).reference(lag_s=0.04).linear, 0.32)
    assert drive(SQUARE, at).reference().linear == 0.3
    turn = drive(SQUARE, replace(at, segment=1)).reference(lag_s=0.04)
    assert (turn.linear, turn.curvature) == (0.0, 0.0)
    assert isclose(turn.turning, 0.32)


def test_a_slow_base_does_not_turn_before_its_corner_nor_straighten_before_its_stop() -> None:
    near_corner = drive(SQUARE, going(0.5, length=0.99))
    assert near_corner.reference(lag_s=0.04).curvature == 0.0
    rounded = Pattern(PatternKind.ROUNDED_SQUARE, 1.0, 0.5)
    last = lap_of(PatternKind.ROUNDED_SQUARE, 1.0).segments[-1]
    at_the_end = drive(rounded, going(0.0, 7, last.length))
    assert isclose(at_the_end.reference(lag_s=0.04).curvature, 10.0)


def test_the_curvature_for_a_slow_base_is_that_of_the_place_ahead() -> None:
    parts = lap_of(PatternKind.FIGURE_EIGHT, 0.5).segments
    driven = drive(
        Pattern(PatternKind.FIGURE_EIGHT, 0.5), going(0.5, length=parts[0].length - 0.01)
    )
    ahead = driven.reference(lag_s=0.06).curvature
    assert isclose(ahead, parts[1].curvature_at(0.02))
    far_ahead = driven.reference(lag_s=2.0).curvature
    assert isclose(far_ahead, parts[1].curvature_at(parts[1].length)), "at most a segment ahead"


def test_a_lead_that_has_arrived_waits_for_the_reference() -> None:
    legs = legs_for(lap_of(PatternKind.SQUARE, 1.0), 0.5, LIMITS)
    at, stands, ticks = going(0.3, length=0.9), False, 0
    while not stands and ticks < 100:
        before, ticks = at, ticks + 1
        at, stands = advanced(at, legs, 1, 0.02, 4)
        assert at.lead_speed >= 0.0
        assert at.length >= before.length
        assert at.lead_speed == 0.0 or at.length + at.ahead < 1.0
    assert stands
    assert (at.segment, at.length) == (0, 1.0)


def test_a_drive_that_goes_on_begins_within_its_first_segment_or_at_rest() -> None:
    short, long = Leg(0.01, 1.0, 1.0, 0.0, 0.0), Leg(1.0, 1.0, 1.0, 0.0, 0.0)
    assert begun(0.5, 5, 0.02, (short, long), turns=False) == Progress()
    assert begun(0.5, 5, 0.02, (long, short), turns=False).speed == 0.5
    assert begun(0.5, 5, 0.25, (replace(long, length=0.25),), turns=False) == Progress()


@for_each("ticks", [1, 2, 5])
def test_a_drive_that_goes_on_moves_as_if_it_had_come_from_before(ticks: int) -> None:
    leg = Leg(1.0, 0.5, 1.0, 0.0, 0.0)
    at = begun(0.5, ticks, 0.125, (leg,), turns=False)
    assert len(at.rates) == ticks - 1, "the next tick makes it as many as an acceleration takes"
    next_at, _ = advanced(at, (leg,), 0, 0.125, ticks)
    assert (next_at.speed, next_at.accel, next_at.ahead) == (0.5, 0.0, at.ahead)


def test_a_drive_that_goes_on_keeps_its_speed_unless_it_begins_with_a_turn() -> None:
    for pattern, speed in ((SQUARE, 0.3), (CIRCLE, 0.3), (Pattern(PatternKind.TURN), 0.0)):
        assert drive(pattern).begin_at(0.3, LIMITS, 0.02, 4).progress.speed == speed


def test_the_end_of_a_segment_is_the_beginning_of_the_next_one() -> None:
    slow, fast = Leg(1.0, 0.5, 1.0, 0.5, 0.0), Leg(1.0, 1.0, 1.0, 0.5, 0.0)
    at, _ = advanced(going(0.5, length=0.875), (slow, fast), 2, 0.25, 1)
    assert (at.laps, at.segment, at.length, at.speed) == (0, 1, 0.0, 0.5)
    at, _ = advanced(replace(at, segment=0, length=1.0), (slow, fast), 2, 0.25, 1)
    assert (at.laps, at.segment, at.length, at.speed) == (0, 1, 0.1875, 0.75)
    at, _ = advanced(going(0.5, 1, 1.0), (fast, slow), 3, 0.25, 1)
    assert (at.laps, at.segment, at.length, at.speed) == (1, 0, 0.1875, 0.75)


@for_each("ahead_m", [0.25, 2.0])
def test_a_lead_beyond_a_stop_comes_back_to_it(ahead_m: float) -> None:
    stop, beyond = Leg(1.0, 1.0, 1.0, 0.0, 0.0), Progress(length=0.875, ahead=ahead_m)
    at, stands = advanced(replace(beyond, rates=(1.0,) * 3), (stop, stop), 1, 0.25, 4)
    assert stands
    assert (at.segment, at.length) == (0, 1.0)


@for_each(("left_m", "stands"), [(2e-9, True), (2.1e-9, False)])
def test_a_lead_within_a_nanometre_of_a_stop_is_there(left_m: float, stands: bool) -> None:
    leg = Leg(left_m, 1e-9, 1.0, 0.0, 0.0)  # the lead moves by a nanometre
    assert advanced(Progress(), (leg,), 1, 1.0, 1)[1] is stands


@for_each("open_loop", [True, False])
def test_only_in_open_loop_a_corner_is_left_before_the_robot_arrives(open_loop: bool) -> None:
    course = replace(PLAIN, open_loop=open_loop)
    waiting = replace(drive(SQUARE, LINE_END), course=course)
    assert after(waiting, 0.02).segment == int(open_loop)


def test_the_figure_eight_goes_where_its_heading_points() -> None:
    """Each of the 720 chords has the heading at its middle."""
    eight = whole_eight(0.5)
    piece_m = eight.length / 720
    for number in range(720):
        begin, end = eight.pose_at(number * piece_m), eight.pose_at((number + 1) * piece_m)
        heading = eight.pose_at((number + 0.5) * piece_m).theta
        assert isclose(end.x - begin.x, piece_m * cos(heading), abs_tol=1e-9)
        assert isclose(end.y - begin.y, piece_m * sin(heading), abs_tol=1e-9)


def test_the_figure_eight_is_as_long_as_two_circles_and_turns_most_at_a_quarter() -> None:
    eight = whole_eight(0.5)
    assert isclose(eight.length, 2 * Circle(0.5).length)
    parts = lap_of(PatternKind.FIGURE_EIGHT, 0.5).segments
    assert isclose(sum(part.length for part in parts), eight.length)
    assert isclose(eight.curvature_at(eight.length / 4), eight.top_curvature)


@for_each("lap", [0, 1])
def test_the_distance_to_the_figure_eight_is_exact_for_a_robot_beside_its_reference(
    lap: int,
) -> None:
    eight = whole_eight(1.0)
    for share in (0.0, 0.1, 0.3, 0.5, 0.77, 0.99):
        length = share * eight.length
        for beside_m in (-0.2, 0.0, 0.3):
            point = eight.pose_at(length).compose(Pose(0.0, beside_m, 0.0))
            far_m = eight.distance_to(point, length + lap * eight.length)
            assert isclose(far_m, abs(beside_m), abs_tol=1e-9)


# The law


@for_each("theta", [0.0, 1e-7, 1e-3, -0.5])
def test_the_correction_sideways_is_smooth_around_a_heading_without_error(theta: float) -> None:
    gains, limits = KernelParams().tracking, VelocityLimits()
    command = track(Reference(Pose(0.0, 0.02, theta), 0.4, 0.0, 0.1), ORIGIN, gains, limits)
    sinc = sin(theta) / theta if theta else 1.0
    sideways = gains.k_y * 0.4 * sinc * 0.02
    assert isclose(command.angular, 0.1 + sideways + gains.k_theta * theta)


def test_a_path_is_planned_for_the_present_speed_and_limits() -> None:
    path, slow = path_for(Pattern(), PLAIN, 1), replace(LIMITS, linear_accel_mps2=0.2)
    for speed_mps, limits in ((0.2, LIMITS), (0.5, LIMITS), (0.2, LIMITS), (0.2, slow)):
        assert legs_for(path, speed_mps, limits) == speed_plan(path, speed_mps, limits)
    circle = lap_of(PatternKind.CIRCLE, 0.4)
    assert legs_for(circle, 0.2, slow) == speed_plan(circle, 0.2, slow)


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
