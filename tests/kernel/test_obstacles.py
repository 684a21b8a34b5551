"""Obstacles: what lies in the path of the present command stops the robot, all else does not."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, cos, hypot, inf, nan, pi, sin, sqrt, tau

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.checks import scan_lost
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.obstacles import (
    _along_path,
    _points,
    _side_m,
    distance_ahead,
    farthest_m,
    free_beside_m,
    is_free,
)
from robotctl.kernel.params import KernelParams, ScanParams, VelocityLimits
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.state import Health, Scan
from robotctl.kernel.types import Cause, ScanReceived, Twist
from robotctl.testing.kernels import Bench, moving, ready, reset, start, stopped_by
from tests.support.cases import for_each

SECTORS = 64
PARAMS = ScanParams(use=Use.OPTIONAL)
FREE = (inf,) * SECTORS


def seen(x: float, y: float, params: ScanParams = PARAMS) -> tuple[float, ...]:
    """Return the sectors of a scan that sees one point, given in the robot's frame."""
    x, y = x - params.x_m, y - params.y_m
    number = int((atan2(y, x) - params.yaw_rad + pi) % tau / tau * SECTORS) % SECTORS
    return tuple(hypot(x, y) if each == number else inf for each in range(SECTORS))


def ahead(x: float, y: float, command: Twist, params: ScanParams = PARAMS) -> float:
    return distance_ahead(seen(x, y, params), command, params, 1.0)


FORWARD, LEFT, RIGHT = Twist(0.5, 0.0), Twist(0.5, 0.5), Twist(0.5, -0.5)


@for_each(
    ("x", "y", "command", "is_hit"),
    [
        (1.0, 0.0, FORWARD, True),
        (-1.0, 0.0, FORWARD, False),
        (1.0, 0.5, FORWARD, False),
        (1.0, 0.0, Twist(-0.5, 0.0), False),
        (-1.0, 0.0, Twist(-0.5, 0.0), True),
        (0.9, 0.4, LEFT, True),
        (0.3, 0.9, LEFT, False),
        (0.9, 0.4, RIGHT, False),
        (0.9, -0.4, RIGHT, True),
        (-0.9, 0.4, Twist(-0.5, -0.5), True),
        (-0.9, -0.4, Twist(-0.5, 0.5), True),
        (-0.9, 0.4, LEFT, False),
        (0.3, 0.0, Twist(0.0, 1.0), True),
        (0.0, 0.5, Twist(0.0, 1.0), False),
        (1.0, 0.0, Twist(), True),
        (2.0, 0.0, FORWARD, False),
    ],
)
def test_only_what_lies_in_the_path_counts(
    x: float, y: float, command: Twist, is_hit: bool
) -> None:
    assert (ahead(x, y, command) < inf) is is_hit


def test_the_distance_is_that_of_the_front() -> None:
    assert ahead(1.0, 0.0, FORWARD) == pytest.approx(0.75, abs=0.01)
    assert _along_path(1.0, 1.0, LEFT, PARAMS) == pytest.approx(pi / 2.0 - 0.25)
    assert _along_path(1.0, -1.0, RIGHT, PARAMS) == pytest.approx(pi / 2.0 - 0.25)


@for_each(
    ("x", "y", "command", "distance_m"),
    [
        (0.0, 0.0, FORWARD, 0.0),
        (1.0, 0.25, FORWARD, 0.75),
        (1.0, -0.25, FORWARD, 0.75),
        (1.0, 0.26, FORWARD, inf),
        (0.0, 0.25, LEFT, 0.0),
        (0.25, -0.25, LEFT, 0.0),
        (0.25, 0.25, RIGHT, 0.0),
        (-0.01, 0.0, LEFT, inf),
        (0.25, 0.25, Twist(0.0, 1.0), 0.0),
        (0.25, 0.26, Twist(0.0, 1.0), inf),
        (-0.25, -0.25, Twist(0.0, 1.0), 0.0),
        (-0.25, -0.26, Twist(0.0, 1.0), inf),
        (-0.2, 0.0, Twist(0.001, 0.1), inf),
        (-0.2, 0.0, Twist(0.00099, 0.1), 0.0),
        (0.5, 0.0, Twist(0.0009, 0.0), 0.25),
    ],
)
def test_the_edge_of_the_robot_belongs_to_it(
    x: float, y: float, command: Twist, distance_m: float
) -> None:
    assert _along_path(x, y, command, PARAMS) == pytest.approx(distance_m)


def test_an_obstacle_as_far_away_as_it_may_count_counts() -> None:
    distance_m = ahead(1.0, 0.0, FORWARD)
    assert distance_ahead(seen(1.0, 0.0), FORWARD, PARAMS, distance_m) == distance_m
    assert distance_ahead(seen(1.0, 0.0), FORWARD, PARAMS, distance_m - 1e-9) == inf
    assert free_beside_m(seen(1.5, 0.0), PARAMS, 1.0) == 0.0
    assert free_beside_m(seen(1.5001, 0.0), PARAMS, 1.0) == inf


def test_an_obstacle_may_be_at_the_edges_and_in_the_middle_of_its_sector() -> None:
    quarter = _points((inf, inf, 1.0, inf), PARAMS, 2.0)
    places = [(1.0, 0.0), (sqrt(0.5), sqrt(0.5)), (0.0, 1.0)]
    assert quarter == [pytest.approx(place) for place in places]


def test_an_arc_of_a_kilometre_counts_as_straight() -> None:
    assert _along_path(30.0, 0.26, Twist(1.0, 0.001), PARAMS) == inf
    assert _along_path(30.0, 0.26, Twist(1.0, 0.0005), PARAMS) == inf
    assert _along_path(30.0, 0.26, Twist(0.9995, 0.001), PARAMS) < 30.0


def test_an_obstacle_counts_as_far_as_it_can_be_on_a_path() -> None:
    params = replace(PARAMS, x_m=0.5, y_m=-0.125)
    assert farthest_m(params, 1.0) == 1.0 + 0.25 + 0.25 + 0.5 + 0.125


RANGES = st.lists(st.floats(0.05, 2.0), min_size=SECTORS, max_size=SECTORS)
COMMANDS = st.builds(Twist, st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))


MOUNTED = ScanParams(use=Use.OPTIONAL, half_width_m=0.2, half_length_m=0.3, x_m=0.1, yaw_rad=0.5)
COURSES = st.builds(Twist, st.floats(-1.0, 1.0), st.floats(-0.5, 0.5) | st.just(0.0))
WIDE = st.lists(st.floats(0.05, 3.0), min_size=SECTORS, max_size=SECTORS)
BETWEEN_WALLS = tuple(
    0.5 / max(abs(sin(-pi + (number + 0.5) * tau / SECTORS)), 1e-9) for number in range(SECTORS)
)


@given(WIDE, COURSES, st.sampled_from([PARAMS, MOUNTED]), st.floats(0.0, 1.5))
def test_what_is_left_out_beside_the_path_is_in_no_path(
    ranges: list[float], command: Twist, params: ScanParams, reach_m: float
) -> None:
    sectors = tuple(ranges)
    ahead_m = distance_ahead(sectors, command, params, reach_m)
    alone_m = min(
        distance_ahead(
            tuple(r if i == n else inf for i in range(SECTORS)), command, params, reach_m
        )
        for n, r in enumerate(sectors)
    )
    assert ahead_m == alone_m
    if is_free(free_beside_m(sectors, params, 1.5), command, params, reach_m):
        assert ahead_m == inf


@given(
    st.floats(0.05, 1.0),
    st.sampled_from([0.0, 0.01, -0.1, 0.3, -0.6, 1.0, 2.5]),
    st.floats(0.1, 1.5),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.sampled_from([1.0, -1.0]),
)
def test_the_side_of_a_path_reaches_as_far_as_the_path(
    linear: float, angular: float, reach_m: float, along: float, across: float, way: float
) -> None:
    command = Twist(way * linear, angular)
    radius_m = linear / abs(angular) if angular else 1e4
    turned_rad = along * (reach_m + PARAMS.half_length_m) / radius_m
    half_m = PARAMS.half_width_m
    off_m = radius_m + half_m * (2.0 * across - 1.0)
    x = way * off_m * sin(turned_rad)
    y = (radius_m - off_m * cos(turned_rad)) * (1.0 if angular * way >= 0.0 else -1.0)
    if _along_path(x, y, command, PARAMS) <= reach_m:
        assert abs(y) <= _side_m(command, PARAMS, reach_m)


def test_the_side_of_a_path_is_no_wider_than_its_end_needs() -> None:
    assert _side_m(Twist(0.5, 0.0), PARAMS, 0.5) == pytest.approx(0.25, abs=1e-5)
    assert _side_m(Twist(0.5, 0.1), PARAMS, 0.5) == pytest.approx(0.25 + 0.75**2 / 10.0, abs=1e-5)
    assert _side_m(Twist(0.5, 0.66), PARAMS, 0.5) < inf
    assert _side_m(Twist(0.75, 1.0), PARAMS, 0.5) == pytest.approx(0.25 + 0.75 / 2.0, abs=1e-5)
    assert _side_m(Twist(0.001, 0.001), PARAMS, 0.5) < inf
    for sharp in (Twist(0.5, 0.67), Twist(-0.5, -0.67), Twist(0.0, 0.1), Twist(0.0005, 0.0001)):
        assert _side_m(sharp, PARAMS, 0.5) == inf


def test_between_walls_a_straight_path_is_free_and_a_sharp_turn_is_looked_at() -> None:
    free_m = free_beside_m(BETWEEN_WALLS, PARAMS, 1.0)
    assert 0.4 < free_m < 0.5
    assert is_free(free_m, Twist(0.3, 0.0), PARAMS, 0.5)
    assert is_free(free_m, Twist(0.3, 0.05), PARAMS, 0.5)
    assert not is_free(free_m, Twist(0.3, 0.6), PARAMS, 0.5)
    assert not is_free(free_m, Twist(0.0, 0.6), PARAMS, 0.5)
    assert not is_free(0.25, Twist(0.3, 0.0), PARAMS, 0.5)
    assert not is_free(_side_m(FORWARD, PARAMS, 0.5), FORWARD, PARAMS, 0.5)
    assert free_beside_m(FREE, PARAMS, 1.0) == inf
    assert free_beside_m((), PARAMS, 1.0) == inf


def test_a_turn_towards_a_wall_is_noticed_at_the_next_tick() -> None:
    bench = moving(replace(KernelParams(), scan=PARAMS))
    bench.give(ScanReceived(bench.t_ns, seen(0.45, 0.32)))
    scan = bench.state.health.scan
    assert scan is not None
    assert scan.ahead_m == inf
    kernel = bench.kernel
    kernel.state = replace(kernel.state, command=Twist(0.3, 0.9))
    bench.tick()
    assert bench.state.cause is Cause.OBSTACLE_NEAR


@given(RANGES, COMMANDS)
def test_left_and_right_are_alike(ranges: list[float], command: Twist) -> None:
    mirrored = Twist(command.linear, -command.angular)
    left = distance_ahead(tuple(ranges), command, PARAMS, 1.0)
    right = distance_ahead(tuple(reversed(ranges)), mirrored, PARAMS, 1.0)
    assert left == pytest.approx(right, abs=1e-6)


@given(RANGES, COMMANDS)
def test_no_distance_is_negative(ranges: list[float], command: Twist) -> None:
    assert distance_ahead(tuple(ranges), command, PARAMS, 1.0) >= 0.0


@given(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_scanner_may_sit_anywhere_and_look_anywhere(yaw: float, x: float, y: float) -> None:
    params = replace(PARAMS, yaw_rad=yaw, x_m=x, y_m=y)
    assert ahead(0.9, 0.0, FORWARD, params) < inf
    assert ahead(-1.5, 0.0, FORWARD, params) == inf


@given(st.floats(0.1, 1.0), st.floats(-1.5, 1.5), st.floats(0.05, 0.9))
def test_the_centre_of_the_path_is_never_free_of_what_lies_on_it(
    linear: float, angular: float, length_m: float
) -> None:
    """The pose after `length_m` of an arc, without a look at the code above."""
    turned = angular * length_m / linear
    if abs(turned) > pi / 2:
        return
    radius_m = linear / angular if abs(angular) > 1e-6 else inf
    x = length_m if radius_m == inf else radius_m * sin(turned)
    y = 0.0 if radius_m == inf else radius_m * (1.0 - cos(turned))
    assert ahead(x, y, Twist(linear, angular)) <= length_m + 0.15


def driving(use: Use = Use.OPTIONAL, accel_mps2: float = 1.0) -> Bench:
    limits = VelocityLimits(linear_accel_mps2=accel_mps2)
    bench = ready(replace(KernelParams(), scan=ScanParams(use=use), limits=limits))
    bench.give(ScanReceived(bench.t_ns, FREE))
    assert not start(bench)
    bench.run(5)
    return bench


def test_an_obstacle_ahead_stops_and_refuses_until_it_is_gone() -> None:
    bench = driving()
    bench.give(ScanReceived(bench.t_ns, seen(0.5, 0.0)))
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)
    assert "m ahead of the robot" in bench.state.reason
    assert not reset(bench)
    bench.give(ScanReceived(bench.t_ns, FREE))
    assert reset(bench)


@for_each("accel_mps2", [1.0, 0.4])
def test_a_tick_looks_ahead_with_the_command_of_that_tick(accel_mps2: float) -> None:
    bench = driving(accel_mps2=accel_mps2)
    bench.give(ScanReceived(bench.t_ns, seen(0.25 + 0.3 + 0.1, 0.0)))
    assert bench.state.mode is Mode.MOVING
    for _ in range(60):  # without a new scan, the robot accelerates
        if bench.state.mode is Mode.MOVING:
            bench.run(1)
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)
    assert max(each.linear for each in bench.commands) == pytest.approx(
        sqrt(2.0 * accel_mps2 * 0.1), abs=0.03
    )


@for_each(("x", "is_near"), [(0.54, True), (0.8, False), (0.81, False), (1.3, False)])
def test_what_stopped_a_fast_robot_is_looked_at_again_when_it_stands(
    x: float, is_near: bool
) -> None:
    """A standing robot looks 0.3 m ahead; beyond 0.8 m nothing of the scan can be that near."""
    limits = VelocityLimits(linear_mps=1.5)
    bench = moving(replace(KernelParams(), scan=PARAMS, limits=limits))
    bench.kernel.state = replace(bench.state, command=Twist(1.5, 0.0))
    bench.give(ScanReceived(bench.t_ns, seen(x, 0.0)))
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)
    bench.run(1)
    assert reset(bench) is not is_near


def test_a_sector_that_is_no_number_hides_no_obstacle() -> None:
    limits = VelocityLimits(linear_mps=1.5)
    bench = moving(replace(KernelParams(), scan=PARAMS, limits=limits))
    sectors = (nan, *seen(1.0, 0.0)[1:])
    bench.give(ScanReceived(bench.t_ns, sectors))
    bench.kernel.state = replace(bench.state, command=Twist(1.0, 0.0))
    bench.run(1)
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)


def test_an_unreadable_scan_stops() -> None:
    bench = driving()
    bench.give(ScanReceived(bench.t_ns, ()))
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)


@for_each("use", [Use.REQUIRED, Use.OPTIONAL])
def test_a_required_scan_that_falls_silent_stops(use: Use) -> None:
    bench = driving(use)
    bench.run(21)
    assert stopped_by(bench, Cause.SCAN_LOST, Mode.ERROR) is (use is Use.REQUIRED)


@for_each("way", [1, -1])
def test_a_scan_is_lost_after_half_a_second_whatever_the_clock_shows(way: int) -> None:
    params, t_ns = KernelParams(scan=ScanParams(use=Use.REQUIRED)), NS_PER_S
    for age_ns, said in ((500_000_000, ""), (700_000_000, "no scan on scan for 0.70 s")):
        scan = Scan(t_ns - way * age_ns, FREE)
        assert scan_lost(Health(scan=scan), params, t_ns) == said


def test_a_required_scan_that_was_never_heard_refuses_the_start() -> None:
    bench = ready(replace(KernelParams(), scan=ScanParams(use=Use.REQUIRED)))
    assert "no scan was received on scan yet" in start(bench)


def test_a_scan_that_is_off_is_ignored() -> None:
    bench = moving()
    bench.give(ScanReceived(bench.t_ns, seen(0.3, 0.0)))
    assert bench.state.mode is Mode.MOVING
