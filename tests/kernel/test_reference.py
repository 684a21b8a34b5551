"""The reference moves along a path: it accelerates, brakes, waits at stops and scores."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, isclose, isnan, pi, sin, sqrt

import pytest

from robotctl.kernel.drive import Drive, Progress
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.patterns import Circle, Line, Pattern, PatternKind, Turn, lap_of
from robotctl.kernel.tracking import Reference, track

LIMITS = VelocityLimits(1.0, 2.0, 0.5, 4.0)
FAR = Pose(50.0, 50.0, 0.0)
"""A pose far from every reference: a robot that never arrives."""

SQUARE = Pattern(PatternKind.SQUARE, 1.0, 0.5)
CIRCLE = Pattern(PatternKind.CIRCLE, 0.4, 0.5)
LINE_END = Progress(segment=0, length=1.0)
TURN_END = Progress(segment=1, length=pi / 2)


def drive(pattern: Pattern, at: Progress | None = None, laps: int = 1) -> Drive:
    return Drive(1, pattern, laps, ORIGIN, at or Progress())


def test_the_reference_speeds_up_with_60_percent_of_the_limit() -> None:
    begun = Progress(length=0.1, settling_s=0.2)
    line = drive(SQUARE, begun).advance(0.1, FAR, LIMITS).progress
    assert line.settling_s == 0.0
    assert isclose(line.speed, 0.6 * 0.5 * 0.1)
    assert isclose(line.length, 0.1 + line.speed * 0.1)
    turn = drive(SQUARE, Progress(segment=1, length=0.1)).advance(0.1, FAR, LIMITS).progress
    assert isclose(turn.speed, 0.6 * 4.0 * 0.1)
    assert isclose(turn.length, 0.1 + turn.speed * 0.1)


@pytest.mark.parametrize(
    ("pattern", "segment", "top_speed"),
    [
        (Pattern(PatternKind.SQUARE, 10.0, 0.5), 0, 0.5),
        (Pattern(PatternKind.SQUARE, 10.0, 5.0), 0, 0.9 * 1.0),
        (Pattern(PatternKind.CIRCLE, 10.0, 5.0), 0, 0.9 * 1.0),
        (Pattern(PatternKind.CIRCLE, 0.4, 5.0), 0, 0.9 * 2.0 * 0.4),
        (Pattern(PatternKind.CIRCLE, 0.25, 0.1), 0, 0.1),
    ],
)
def test_the_top_speed_is_the_patterns_or_90_percent_of_a_limit(
    pattern: Pattern, segment: int, top_speed: float
) -> None:
    fast = drive(pattern, Progress(segment=segment, speed=4.0))
    assert isclose(fast.advance(0.01, FAR, LIMITS).progress.speed, top_speed)


def test_a_turn_is_no_faster_than_90_percent_of_the_limit() -> None:
    limits = replace(LIMITS, angular_rps=0.5)
    fast = drive(SQUARE, Progress(segment=1, speed=4.0))
    assert isclose(fast.advance(0.01, FAR, limits).progress.speed, 0.9 * 0.5)


def test_the_reference_brakes_so_that_it_stands_at_the_stop() -> None:
    """The reference has the speed from which the remaining distance is just enough to brake."""
    for length in (0.5, 0.9, 0.99):
        at = drive(SQUARE, Progress(length=length, speed=0.45)).advance(0.01, FAR, LIMITS).progress
        assert isclose(at.speed, min(0.453, sqrt(2 * 0.3 * (1.0 - length))))
        assert isclose(at.length, length + 0.01 * at.speed)


def test_a_circle_brakes_at_the_end_of_the_last_lap_alone() -> None:
    around = Circle(0.4).length
    near_end = Progress(laps=0, length=around - 0.1, speed=0.4)
    assert drive(CIRCLE, near_end, laps=2).advance(0.01, FAR, LIMITS).progress.speed > 0.4
    assert drive(CIRCLE, near_end, laps=0).advance(0.01, FAR, LIMITS).progress.speed > 0.4
    last = drive(CIRCLE, replace(near_end, laps=1), laps=2).advance(0.01, FAR, LIMITS)
    assert isclose(last.progress.speed, sqrt(2 * 0.3 * 0.1))


def test_what_a_step_has_left_at_a_flowing_end_is_driven_on_the_next_lap() -> None:
    around = Circle(0.4).length
    ended = drive(CIRCLE, Progress(length=around - 0.001, speed=0.45), laps=2)
    at = ended.advance(0.01, Pose(0.03, 0.04, 0.0), LIMITS).progress
    assert (at.laps, at.segment) == (1, 0)
    assert isclose(at.length, 0.453 * 0.01 - 0.001)
    assert isclose(at.speed, 0.453)
    assert isclose(at.closure_m, 0.05)


@pytest.mark.parametrize("at", [LINE_END, TURN_END])
def test_the_reference_waits_at_a_stop_and_counts_the_time(at: Progress) -> None:
    waiting = drive(SQUARE, replace(at, speed=0.2, settling_s=0.1)).advance(0.02, FAR, LIMITS)
    assert waiting.progress == replace(at, speed=0.0, settling_s=0.1 + 0.02)


@pytest.mark.parametrize(
    ("pose", "arrived"),
    [
        (Pose(1.0, 0.0, 0.0), True),
        (Pose(0.9951, 0.0, 0.0), True),
        (Pose(1.0049, 0.0, 0.0), True),
        (Pose(0.9949, 0.0, 0.0), False),
        (Pose(1.0051, 0.0, 0.0), False),
        (Pose(1.0, 0.0, 0.0099), True),
        (Pose(1.0, 0.0, -0.0099), True),
        (Pose(1.0, 0.0, 0.0101), False),
        (Pose(1.0, 0.0, -0.0101), False),
        (Pose(0.9, 0.0, 0.1), False),
        (Pose(1.0, 0.1, 0.0), True),  # driving on straight ahead would not help
    ],
)
def test_a_robot_has_arrived_within_5_mm_and_a_hundredth_of_a_radian(
    pose: Pose, arrived: bool
) -> None:
    for frame in (ORIGIN, Pose(3.0, -2.0, 1.0)):
        waiting = replace(drive(SQUARE, LINE_END), origin=frame)
        after = waiting.advance(0.02, frame.compose(pose), LIMITS).progress
        assert after == (Progress(segment=1) if arrived else replace(LINE_END, settling_s=0.02))


def test_a_robot_5_mm_from_a_stop_has_not_arrived() -> None:
    """The line is 5 mm long: no other distance is exact."""
    tiny = drive(Pattern(PatternKind.SQUARE, 0.005), Progress(length=0.005))
    assert tiny.advance(0.02, ORIGIN, LIMITS).progress.segment == 0


def test_a_lap_of_the_square_has_eight_segments_and_ends_where_the_robot_is() -> None:
    at = Progress(segment=7, length=pi / 2, closure_m=0.5)
    origin = Pose(1.0, 2.0, 0.0)
    ended = replace(drive(SQUARE, at), origin=origin).advance(0.02, origin, LIMITS)
    assert ended.progress == Progress(laps=1, closure_m=0.0)
    assert ended.finished
    assert isnan(Progress().closure_m)


@pytest.mark.parametrize(
    ("laps", "driven", "finished"),
    [(0, 9, False), (2, 1, False), (2, 2, True), (1, 0, False), (1, 2, True)],
)
def test_a_drive_is_finished_after_its_laps(laps: int, driven: int, finished: bool) -> None:
    assert drive(SQUARE, Progress(laps=driven), laps).finished is finished


def test_the_figures_of_the_last_lap_stay_during_the_next() -> None:
    for at in (Progress(length=0.3), LINE_END, replace(LINE_END, settling_s=9.0)):
        begun = drive(SQUARE, replace(at, laps=1, closure_m=0.02), laps=3)
        after = begun.advance(0.02, FAR, LIMITS).progress
        assert (after.laps, after.closure_m) == (1, 0.02)


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
    assert drive(SQUARE, at).from_standstill().progress == replace(at, speed=0.0)


def test_the_score_sums_up_the_distances_from_the_path() -> None:
    origin = Pose(2.0, 1.0, 0.5)
    scored = replace(drive(SQUARE, Progress(length=0.5)), origin=origin)
    assert scored.report().cross_track_rms_m == 0.0
    for beside_m, behind_m in ((0.03, 0.0), (-0.04, 0.3), (0.0, 0.0)):
        pose = origin.compose(Pose(0.5 - behind_m, beside_m, 0.0))
        scored = scored.measured(pose, 0.25)
        assert isclose(scored.score.error_m, sqrt(beside_m**2 + behind_m**2), abs_tol=1e-9)
    report = scored.report()
    assert report.distance_m == 0.75
    assert isclose(report.cross_track_max_m, 0.04)
    assert isclose(report.cross_track_rms_m, sqrt((0.03**2 + 0.04**2) / 3))
    assert report.laps == 0
    assert isnan(report.closure_m)


@pytest.mark.parametrize(("away_m", "told_m"), [(0.5, 0.5), (0.75, inf)])
def test_a_robot_further_away_than_the_pattern_is_large_is_infinitely_far(
    away_m: float, told_m: float
) -> None:
    pattern = Pattern(PatternKind.SQUARE, 0.5)
    assert drive(pattern).measured(Pose(-away_m, 0.0, 0.0), 0.0).score.error_m == told_m


# Distances and outlines


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


@pytest.mark.parametrize("from_centre_m", [0.0, 1.5, 2.0, 2.5])
def test_the_distance_to_a_circle_is_that_along_its_radius(from_centre_m: float) -> None:
    for angle in (0.0, 1.0, 4.0):
        point = Pose(from_centre_m * cos(angle), 2.0 + from_centre_m * sin(angle), 0.0)
        assert isclose(Circle(2.0).distance_to(point, 0.0), abs(from_centre_m - 2.0), abs_tol=1e-12)


def test_the_outline_of_a_square_is_its_corners() -> None:
    outline = lap_of(PatternKind.SQUARE, 2.0).outline()
    assert outline[0] == ORIGIN
    assert len(outline) == 9
    corners = [(0, 0), (2, 0), (2, 0), (2, 2), (2, 2), (0, 2), (0, 2), (0, 0), (0, 0)]
    for pose, (x, y) in zip(outline, corners, strict=True):
        assert isclose(pose.x, x, abs_tol=1e-9)
        assert isclose(pose.y, y, abs_tol=1e-9)


def test_the_outline_of_a_circle_is_a_pose_every_2_degrees() -> None:
    outline = lap_of(PatternKind.CIRCLE, 0.5).outline()
    assert len(outline) == 181
    for number, pose in enumerate(outline):
        assert isclose(pose.theta, number * pi / 90, abs_tol=1e-9)


def test_the_figure_eight_goes_where_its_heading_points() -> None:
    """Each of the 720 chords has the heading at its middle."""
    eight = lap_of(PatternKind.FIGURE_EIGHT, 0.5).segments[0]
    piece_m = eight.length / 720
    for number in range(720):
        begin, end = eight.pose_at(number * piece_m), eight.pose_at((number + 1) * piece_m)
        heading = eight.pose_at((number + 0.5) * piece_m).theta
        assert isclose(end.x - begin.x, piece_m * cos(heading), abs_tol=1e-9)
        assert isclose(end.y - begin.y, piece_m * sin(heading), abs_tol=1e-9)


def test_the_figure_eight_is_as_long_as_two_circles_and_turns_most_at_a_quarter() -> None:
    eight = lap_of(PatternKind.FIGURE_EIGHT, 0.5).segments[0]
    assert isclose(eight.length, 2 * Circle(0.5).length)
    assert isclose(eight.curvature_at(eight.length / 4), eight.top_curvature)


@pytest.mark.parametrize("lap", [0, 1])
def test_the_distance_to_the_figure_eight_is_exact_for_a_robot_beside_its_reference(
    lap: int,
) -> None:
    eight = lap_of(PatternKind.FIGURE_EIGHT, 1.0).segments[0]
    for share in (0.0, 0.1, 0.3, 0.5, 0.77, 0.99):
        length = share * eight.length
        for beside_m in (-0.2, 0.0, 0.3):
            point = eight.pose_at(length).compose(Pose(0.0, beside_m, 0.0))
            far_m = eight.distance_to(point, length + lap * eight.length)
            assert isclose(far_m, abs(beside_m), abs_tol=1e-9)


# The law


@pytest.mark.parametrize("theta", [0.0, 1e-7, 1e-3, -0.5])
def test_the_correction_sideways_is_smooth_around_a_heading_without_error(theta: float) -> None:
    gains, limits = KernelParams().tracking, VelocityLimits()
    command = track(Reference(Pose(0.0, 0.02, theta), 0.4, 0.0, 0.1), ORIGIN, gains, limits)
    sinc = sin(theta) / theta if theta else 1.0
    sideways = gains.k_y * 0.4 * sinc * 0.02
    assert isclose(command.angular, 0.1 + sideways + gains.k_theta * theta)
