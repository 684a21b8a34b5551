"""Obstacles: what lies in the path of the present command stops the robot, all else does not."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, cos, hypot, inf, pi, sin, sqrt, tau

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.modes import Mode
from robotctl.kernel.obstacles import ScanParams, distance_ahead
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.types import Cause, ScanReceived, Twist
from robotctl.testing.kernels import Bench, moving, ready, reset, start, stopped_by

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


@pytest.mark.parametrize(
    ("x", "y", "command", "is_hit"),
    [
        (1.0, 0.0, FORWARD, True),
        (-1.0, 0.0, FORWARD, False),
        (1.0, 0.5, FORWARD, False),
        (1.0, 0.0, Twist(-0.5, 0.0), False),
        (-1.0, 0.0, Twist(-0.5, 0.0), True),
        (0.9, 0.4, LEFT, True),
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


RANGES = st.lists(st.floats(0.05, 2.0), min_size=SECTORS, max_size=SECTORS)
COMMANDS = st.builds(Twist, st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))


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


def driving(use: Use = Use.OPTIONAL) -> Bench:
    bench = ready(replace(KernelParams(), scan=ScanParams(use=use)))
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


def test_a_faster_robot_stops_earlier() -> None:
    near, far = replace(PARAMS), seen(0.25 + 0.3 + 0.1, 0.0)
    slow, fast = Twist(0.1, 0.0), Twist(0.6, 0.0)
    for command, is_hit in ((slow, False), (fast, True)):
        reach_m = near.stop_distance_m + command.linear**2 / 2.0
        assert (distance_ahead(far, command, near, reach_m) < inf) is is_hit


def test_a_tick_looks_ahead_with_the_command_of_that_tick() -> None:
    bench = driving()
    bench.give(ScanReceived(bench.t_ns, seen(0.25 + 0.3 + 0.1, 0.0)))
    assert bench.state.mode is Mode.MOVING
    for _ in range(40):  # without a new scan, the robot accelerates
        if bench.state.mode is Mode.MOVING:
            bench.run(1)
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)
    assert max(each.linear for each in bench.commands) == pytest.approx(sqrt(2.0 * 0.1), abs=0.03)


def test_an_unreadable_scan_stops() -> None:
    bench = driving()
    bench.give(ScanReceived(bench.t_ns, ()))
    assert stopped_by(bench, Cause.OBSTACLE_NEAR, Mode.ERROR)


@pytest.mark.parametrize("use", [Use.REQUIRED, Use.OPTIONAL])
def test_a_required_scan_that_falls_silent_stops(use: Use) -> None:
    bench = driving(use)
    bench.run(21)
    assert stopped_by(bench, Cause.SCAN_LOST, Mode.ERROR) is (use is Use.REQUIRED)


def test_a_required_scan_that_was_never_heard_refuses_the_start() -> None:
    bench = ready(replace(KernelParams(), scan=ScanParams(use=Use.REQUIRED)))
    assert "no scan was received on scan yet" in start(bench)


def test_a_scan_that_is_off_is_ignored() -> None:
    bench = moving()
    bench.give(ScanReceived(bench.t_ns, seen(0.3, 0.0)))
    assert bench.state.mode is Mode.MOVING
