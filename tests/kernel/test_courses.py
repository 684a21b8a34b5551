"""Lines, arcs, turns and waypoints: where they lead, how smoothly, and what is refused by name."""

from __future__ import annotations

from itertools import pairwise
from math import hypot, inf, isclose, nan, pi, sqrt

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robotctl.kernel.course import MIN_LEG_M, PLAIN, Course, Frame, Held, Point
from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import VelocityLimits
from robotctl.kernel.path import Line, Path
from robotctl.kernel.patterns import (
    SHAPES,
    START_RAD,
    STRAIGHT_RAD,
    Pattern,
    PatternKind,
    local_points,
    named,
    path_of,
    waypoint_path,
)
from robotctl.kernel.speed_plan import speed_plan
from robotctl.kernel.tracking import Reference, limit
from robotctl.kernel.types import Twist
from robotctl.sim import SimParams
from robotctl.testing.kernels import Driven, drive_simulated, ready
from tests.support.cases import for_each

BASE = SimParams(
    lag_s=0.04,
    actuation_linear_factor=0.985,
    actuation_angular_factor=1.03,
    odometry_linear_factor=1.0,
    odometry_angular_factor=1.0,
)
ZIGZAG: tuple[Point, ...] = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (2.0, 1.5), (0.0, 2.0))
SIZED = [kind for kind, shape in SHAPES.items() if shape.size_name]
LIMITS = VelocityLimits()


def driven(pattern: Pattern, course: Course = Course(), *, laps: int = 1) -> Driven:  # noqa: B008
    result = drive_simulated(pattern, laps=laps, course=course, sim=BASE)
    assert result.ended.completed, result.ended
    return result


@for_each("kind", PatternKind)
def test_a_pattern_tells_what_shapes_it(kind: PatternKind) -> None:
    pattern, shape = Pattern(kind, 1.0), SHAPES[kind]
    plain = path_of(pattern, PLAIN)
    assert (path_of(pattern, Course(angle_rad=1.0)) != plain) is shape.has_angle
    assert (path_of(pattern, Course(corner_m=0.2)) != plain) is shape.has_corner
    assert plain.closed is shape.closed
    assert (path_of(Pattern(kind, 2.0), PLAIN) != plain) is (shape.size_name is not None)


@for_each("reverse", [False, True])
def test_waypoints_in_the_frame_of_odometry_are_driven_there(reverse: bool) -> None:
    bench = ready()
    bench.odometry(Pose(3.0, 1.0, 1.0))
    points = ((3.0, 1.5), (4.0, 1.5))
    bench.drive(laps=1, course=Course(waypoints=points, frame=Frame.ODOM, reverse=reverse))
    drive = bench.state.drive
    assert drive is not None
    begin, *_, end = [drive.origin.compose(pose) for pose in drive.path.outline()]
    assert begin.distance(Pose(3.0, 1.0)) <= 1e-9
    assert end.distance(Pose(4.0, 1.5)) <= 1e-9


@for_each("frame", Frame)
def test_a_path_behind_the_robot_is_driven_in_reverse_without_a_turn(frame: Frame) -> None:
    course = Course(waypoints=((0.0, 0.0), (-1.0, 0.0)), frame=frame, reverse=True)
    result = driven(Pattern(), course)
    assert result.pose.distance(Pose(-1.0, 0.0)) <= 0.03
    assert max(abs(command.angular) for command in result.commands) <= 0.3


PLACES = st.lists(
    st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)), min_size=2, max_size=12
).map(tuple)


@given(points=PLACES, corner_m=st.sampled_from((0.0, 0.05, 0.2, 2.0)), again=st.booleans())
@settings(max_examples=150)
def test_a_path_through_any_waypoints_has_no_gap_and_no_kink(
    points: tuple[Point, ...], corner_m: float, again: bool
) -> None:
    assume(not Course(waypoints=points).refusal())
    path = waypoint_path(points, corner_m, again=again)
    assume(path.segments)  # without them the kernel refuses the drive
    first = path.segments[0].pose_at(0.0)
    assert hypot(first.x, first.y) <= 1e-6
    assert abs(first.theta) <= START_RAD
    # A last point that near the origin counts as the origin, where a closed path turns.
    gap_m = MIN_LEG_M if again else 1e-6
    for before, after in pairwise(path.segments):
        end, begin = before.pose_at(before.length), after.pose_at(0.0)
        assert end.distance(begin) <= gap_m
        assert abs(wrap_angle(end.theta - begin.theta)) <= 1e-6
    last = path.segments[-1].pose_at(path.segments[-1].length)
    target = (0.0, 0.0) if again else points[-1]
    assert hypot(last.x - target[0], last.y - target[1]) <= 0.03
    assert path.end == (ORIGIN if again else last)
    assert not again or abs(wrap_angle(last.theta)) <= STRAIGHT_RAD
    legs = speed_plan(path, 0.5, LIMITS)
    for leg, segment in zip(legs, path.segments, strict=True):
        assert leg.top_speed > 0.0
        assert 0.0 <= leg.last_end_speed <= leg.end_speed <= leg.top_speed
        if not segment.turns:
            assert leg.top_speed * segment.top_curvature <= LIMITS.angular_rps


def test_the_plan_brakes_over_more_than_one_segment() -> None:
    lines = tuple(Line(Pose(0.02 * number, 0.0, 0.0), 0.02) for number in range(3))
    first, second, _ = speed_plan(Path(lines, 0.06, False), 0.5, LIMITS)
    assert isclose(second.last_end_speed, sqrt(2.0 * 0.9 * 0.02))
    assert isclose(first.last_end_speed, sqrt(2.0 * 0.9 * 0.04))


def test_in_open_loop_odometry_does_not_change_the_commands() -> None:
    def commands(aside_m: float) -> list[Twist]:
        bench = ready()
        bench.drive(Pattern(PatternKind.CIRCLE, 0.5), 1, course=Course(open_loop=True))
        for number in range(50):
            bench.odometry(Pose(0.0, aside_m * number / 50.0, 0.0))
            bench.tick()
        return bench.commands

    assert commands(0.1) == commands(0.0)


@for_each(
    ("pattern", "course", "said"),
    [
        (Pattern(), Course(waypoints=((1.0, 1.0),)), "1 points"),
        (Pattern(), Course(waypoints=((0.0, 0.0),) * 2001), "2 to 2000"),
        (Pattern(), Course(waypoints=((2.0, 2.0),) * 3), "the same"),
        (Pattern(), Course(waypoints=((0.0, 0.0), (nan, 1.0))), "point 2"),
        (Pattern(), Course(waypoints=((0.0, -inf), (0.0, 1.0))), "point 1"),
        (Pattern(), Course(waypoints=((0.0, 1e5), (0.0, 1.0))), "10000 m"),
        (Pattern(), Course(corner_m=0.0), "a corner of 0 m"),
        (Pattern(), Course(corner_m=-0.1, waypoints=ZIGZAG), "a corner of -0.1 m"),
        (Pattern(), Course(corner_m=10.1, waypoints=ZIGZAG), "0.02 to 10 m"),
        (Pattern(), Course(corner_m=nan), "a corner of nan m"),
        (Pattern(), Course(angle_rad=0.0), "an angle of 0 rad"),
        (Pattern(), Course(angle_rad=-100.1), "0.01 to 100 rad"),
        (Pattern(PatternKind.ROUNDED_SQUARE), Course(corner_m=0.6), "0.02 to 0.5 m"),
        (Pattern(PatternKind.ROUNDED_SQUARE, 2.0), Course(corner_m=1.1), "0.02 to 1 m"),
        (Pattern(PatternKind.ROUNDED_SQUARE, 0.12), Course(corner_m=0.08), "0.02 to 0.06 m"),
        (Pattern(), Course(waypoints=((0.0, 0.0), (0.0009, 0.0))), "the same"),
        (Pattern(speed_mps=0.0), Course(), "a speed of 0 m/s: use 0.01 to 10 m/s"),
        (Pattern(), Course(held=Held(nan, 0.0, 1.0)), "a velocity of nan m/s, 0 rad/s"),
        (Pattern(), Course(held=Held(0.1, inf, 1.0)), "a velocity of 0.1 m/s, inf rad/s"),
        (Pattern(), Course(held=Held(0.0, 0.0, nan)), "a velocity for nan s"),
        (Pattern(), Course(held=Held(0.1, 0.0, 0.01)), "a velocity for 0.01 s"),
        *((Pattern(kind, 0.09), Course(), "a size of 0.09 m: use 0.1 to") for kind in SIZED),
        *((Pattern(kind, 101.0), Course(), "a size of 101 m: use 0.1 to 100 m") for kind in SIZED),
    ],
)
def test_what_cannot_be_driven_is_refused_by_name(
    pattern: Pattern, course: Course, said: str
) -> None:
    bench = ready()
    bench.drive(pattern, 1, course=course)
    assert not bench.replies[-1].ok
    assert said in bench.replies[-1].message
    assert bench.state.mode is Mode.IDLE


@for_each(
    "course",
    [
        *(Course(angle_rad=side * angle) for side in (-1.0, 1.0) for angle in (0.01, 100.0)),
        *(Course(corner_m=corner_m, waypoints=ZIGZAG) for corner_m in (0.0, 0.02, 10.0)),
        Course(waypoints=((1e4, -1e4), (-1e4, 1e4))),
        Course(waypoints=((0.0, 0.0), (0.001, 0.0))),
        Course(waypoints=((0.0, 0.0), (0.0, -0.001))),
        Course(waypoints=((0.0, 0.0), (0.0, 1.0))),
        Course(waypoints=((0.0, 0.0), (0.0006, 0.0), (0.0012, 0.0))),
        Course(waypoints=((0.0, 0.0), (0.0012, 0.0), (0.0006, 0.0))),
        Course(held=Held(0.1, 0.0, 0.02)),
        Course(held=Held(0.1, 0.0, 600.0)),
        Course(held=Held(0.1, 0.0, 0.125, heard_t_ns=0)),
        Course(waypoints=tuple((0.1 * number, 0.0) for number in range(2000))),
    ],
)
def test_what_lies_at_a_limit_is_driven(course: Course) -> None:
    assert Pattern().refusal(course) == course.refusal() == ""


def test_a_rounded_corner_fits_half_a_side_and_another_need_not() -> None:
    for corner_m in (0.02, 0.3, 0.5):
        assert not Pattern(PatternKind.ROUNDED_SQUARE).refusal(Course(corner_m=corner_m))
    assert not Pattern(PatternKind.SQUARE).refusal(Course(corner_m=0.6))
    waypoints = Course(corner_m=0.6, waypoints=ZIGZAG)
    assert not Pattern(PatternKind.ROUNDED_SQUARE).refusal(waypoints)


def test_points_in_one_place_are_one_point() -> None:
    twice = tuple(point for point in ZIGZAG for _ in range(2))
    assert waypoint_path(twice, 0.1, again=False) == waypoint_path(ZIGZAG, 0.1, again=False)


def test_points_a_millimetre_apart_are_two_points_and_2_cm_from_the_robot_a_leg_begins() -> None:
    def lengths(*points: Point, again: bool = False) -> list[float]:
        return [segment.length for segment in waypoint_path(points, 0.0, again=again).segments]

    assert lengths((0.02, 0.0), (1.0, 0.0)) == [0.02, 0.98]
    assert lengths((0.0199, 0.0), (1.0, 0.0)) == [1.0]
    assert lengths((1.0, 0.0), (1.0, 0.001)) == [1.0, pi / 2, 0.001]
    assert lengths((1.0, 0.0), (0.001, 0.0), again=True) == [1.0, pi, 0.999, 0.001, pi]


@for_each(
    ("kind", "size_m", "reach_m"),
    [
        (PatternKind.SQUARE, 1.0, 2.0),
        (PatternKind.CIRCLE, 0.5, 2.0),
        (PatternKind.FIGURE_EIGHT, 0.5, 2.0),
        (PatternKind.ROUNDED_SQUARE, 1.0, 1.4),
        (PatternKind.LINE, 1.0, 2.0),
        (PatternKind.ARC, 0.5, 2.0),
        (PatternKind.TURN, 1.0, 0.1),
    ],
)
def test_a_pattern_has_a_default_size_and_is_lost_beyond_its_size(
    kind: PatternKind, size_m: float, reach_m: float
) -> None:
    assert SHAPES[kind].default_size_m == size_m
    assert isclose(path_of(Pattern(kind, 2.0), PLAIN).reach_m, reach_m)


def test_a_motion_has_a_name() -> None:
    assert named(Pattern(PatternKind.ARC), Course()) == "an arc"
    assert named(Pattern(), Course(reverse=True, open_loop=True)) == (
        "a square in reverse in open loop"
    )
    assert named(Pattern(), Course(waypoints=ZIGZAG)) == "a path of 5 points"
    held = Held(0.1, 0.0, 1.0, quiet_s=0.5)
    assert named(Pattern(), Course(held=held)) == (
        "0.1 m/s and 0 rad/s for 1 s, then nothing for 0.5 s"
    )


@for_each("reverse", [False, True])
def test_local_points_are_seen_from_the_origin_of_the_drive(reverse: bool) -> None:
    course = Course(waypoints=((1.0, 3.0),), frame=Frame.ODOM, reverse=reverse)
    ((x, y),) = local_points(course, Pose(1.0, 1.0, pi / 2))
    assert x == pytest.approx(-2.0 if reverse else 2.0)
    assert y == pytest.approx(0.0)


@for_each("velocity", [Twist(0.3, 0.0), Twist(-0.2, 0.5), Twist(0.0, -1.0)])
def test_a_velocity_is_held_for_its_time_within_the_limits_and_ramps_down(velocity: Twist) -> None:
    result = driven(Pattern(), Course(held=Held(velocity.linear, velocity.angular, 2.0)))
    assert result.ended.reason == "drive finished: 2 s"
    ramp_s = max(abs(velocity.linear) / 1.0, abs(velocity.angular) / 4.0)
    assert isclose(result.duration_s, 2.0 + ramp_s, abs_tol=0.06)
    assert result.commands[-1] == Twist()
    assert result.commands.count(velocity) > 70
    for before, command in pairwise(result.commands):
        assert limit(before, command, 0.02 + 1e-9, LIMITS) == command
    assert result.ended.report.cross_track_max_m == 0.0
    assert (result.ended.report.distance_m > 0.1) is (velocity.linear != 0.0)


def test_the_reference_of_a_held_velocity_stands_at_the_origin() -> None:
    origin = Pose(1.0, 2.0, 3.0)
    drive = Drive(1, Pattern(), 1, origin, course=Course(held=Held(0.3, 0.5, 2.0)))
    assert drive.reference() == Reference(origin, 0.0, 0.0, 0.0)
    assert drive.cross_track_m(Pose(4.0, 4.0)) == 0.0
    assert not drive.path.closed
