"""The simulated robot follows commands, errs as configured, and stops without commands.

Each fault of the simulated robot stops a drive for its own cause, and ends after its time.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, isclose, nan

import pytest

from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    Cause,
    Odometry,
    OdomReceived,
    PublishTwist,
    Twist,
)
from robotctl.sim import Robot, SimFault, SimParams
from robotctl.testing.kernels import TICK_NS, Bench, moving
from tests.support.cases import for_each
from tests.support.heard_drives import PERFECT

STEP_S = 0.02


def run(robot: Robot, twist: Twist, seconds: float) -> None:
    for _ in range(round(seconds / STEP_S)):
        robot.command(twist)
        robot.advance(STEP_S)


def test_a_perfect_robot_does_what_it_is_told() -> None:
    robot = Robot(replace(PERFECT, linear_accel_mps2=50.0))
    run(robot, Twist(0.5, 0.0), 2.0)
    assert isclose(robot.truth.x, 1.0, abs_tol=1e-9)
    assert robot.truth == robot.odometry


def test_it_keeps_to_its_acceleration_limits() -> None:
    robot = Robot(replace(PERFECT, linear_accel_mps2=1.0, angular_accel_rps2=2.0))
    last = ZERO
    for _ in range(50):
        robot.command(Twist(5.0, -5.0))
        robot.advance(STEP_S)
        assert abs(robot.measured.linear - last.linear) <= 1.0 * STEP_S + 1e-12
        assert abs(robot.measured.angular - last.angular) <= 2.0 * STEP_S + 1e-12
        last = robot.measured


def test_it_lags_behind_a_command() -> None:
    robot = Robot(replace(PERFECT, lag_s=0.2, linear_accel_mps2=50.0))
    run(robot, Twist(1.0, 0.0), 0.2)
    assert isclose(robot.measured.linear, 0.632, abs_tol=0.01)


def test_it_stops_by_itself_when_commands_cease() -> None:
    robot = Robot(SimParams())
    run(robot, Twist(0.5, 1.0), 2.0)
    for _ in range(round(SimParams().command_timeout_s / STEP_S)):
        robot.advance(STEP_S)
        assert robot.measured.linear > 0.1
    for _ in range(100):
        robot.advance(STEP_S)
    assert robot.measured == ZERO


@for_each("value", [nan, inf, -inf])
def test_a_command_that_is_not_finite_stops_it(value: float) -> None:
    robot = Robot(SimParams())
    run(robot, Twist(0.5, 0.0), 1.0)
    run(robot, Twist(value, 0.0), 2.0)
    assert robot.measured == ZERO
    run(robot, Twist(0.5, value), 1.0)
    assert robot.measured == ZERO


def test_odometry_sees_errors_of_actuation() -> None:
    robot = Robot(replace(PERFECT, linear_accel_mps2=50.0, actuation_linear_factor=0.9))
    run(robot, Twist(0.5, 0.0), 2.0)
    assert isclose(robot.odometry.x, 0.9, abs_tol=1e-9)
    assert isclose(robot.truth.x, 0.9, abs_tol=1e-9)


def test_only_the_truth_shows_errors_of_odometry() -> None:
    robot = Robot(replace(PERFECT, linear_accel_mps2=50.0, odometry_linear_factor=1.1))
    run(robot, Twist(0.5, 0.0), 2.0)
    assert isclose(robot.odometry.x, 1.1, abs_tol=1e-9)
    assert isclose(robot.truth.x, 1.0, abs_tol=1e-9)


def test_the_seed_decides_the_noise() -> None:
    ends = []
    for seed in (1, 1, 2):
        robot = Robot(SimParams(seed=seed))
        run(robot, Twist(0.5, 0.3), 5.0)
        ends.append((robot.truth, robot.odometry))
    assert ends[0] == ends[1] != ends[2]


def test_the_battery_lasts_2_hours_from_full_on_any_drive() -> None:
    robot = Robot(SimParams())
    assert robot.battery == 1.0
    elapsed_s = 0.0
    while robot.battery > 0.0:
        robot.command(Twist(0.5, 0.0))
        robot.advance(0.5)
        elapsed_s += 0.5
    assert isclose(elapsed_s, 7200.0, abs_tol=1.0)
    robot.advance(0.5)
    assert robot.battery == 0.0


def test_it_stands_where_it_began_until_it_is_told_to_move() -> None:
    robot = Robot(SimParams())
    for _ in range(100):
        robot.advance(STEP_S)
    assert robot.truth == robot.odometry == ORIGIN


def test_a_robot_that_resumes_drives_on_with_its_wheels_turning() -> None:
    quiet = SimParams(actuation_noise=0.0, odometry_noise=0.0)
    robot, resumed = Robot(quiet), Robot(quiet)
    robot.command(Twist(0.5, 1.0))
    for _ in range(5):
        robot.advance(0.02)
    resumed.resume(robot.odometry, robot.measured, Twist(0.5, 1.0))
    for each in (robot, resumed):
        each.advance(0.02)
    assert 0.0 < robot.measured.linear < 0.4
    assert resumed.measured.linear == pytest.approx(robot.measured.linear, rel=1e-12)
    assert resumed.measured.angular == pytest.approx(robot.measured.angular, rel=1e-12)
    assert resumed.odometry.x == pytest.approx(robot.odometry.x, rel=1e-12)


TICK_S = TICK_NS / 1e9

CAUSES = {
    SimFault.ODOM_LOST: Cause.ODOMETRY_LOST,
    SimFault.ODOM_JUMP: Cause.ODOMETRY_WRONG,
    SimFault.SLIP: Cause.TRACKING_LOST,
    SimFault.HANG: Cause.ODOMETRY_LOST,
    SimFault.BROWNOUT: Cause.BATTERY_LOW,
}


def turn(bench: Bench, robot: Robot) -> None:
    """Let kernel and robot exchange what the node of the simulated robot passes on."""
    robot.advance(TICK_S)
    faults = robot.faults
    if SimFault.HANG not in faults:
        bench.give(BatteryReceived(bench.t_ns, faults.reported_level(robot.battery)))
        if SimFault.ODOM_LOST not in faults:
            pose = faults.reported_pose(robot.odometry)
            bench.give(OdomReceived(bench.t_ns, Odometry(pose, robot.measured, bench.t_ns)))
    for effect in bench.tick():
        if isinstance(effect, PublishTwist):
            robot.command(effect.twist)


def test_every_fault_has_its_cause() -> None:
    assert set(CAUSES) == set(SimFault)


@for_each("fault", SimFault)
def test_a_fault_stops_the_drive_for_its_cause_and_can_be_reset_after_it(fault: SimFault) -> None:
    bench, robot = moving(ticks=0), Robot(SimParams())
    for _ in range(50):
        turn(bench, robot)
    assert bench.state.mode is Mode.MOVING
    robot.faults.begin(fault, 3.0)
    for _ in range(150):
        turn(bench, robot)
    assert bench.state.cause is CAUSES[fault], bench.state.reason
    assert bench.state.command == ZERO
    for _ in range(100):
        turn(bench, robot)
    assert fault not in robot.faults
    bench.request(Mode.IDLE)
    assert bench.replies[-1].ok, bench.replies[-1]


def test_a_robot_that_hangs_keeps_its_command_until_its_own_timeout() -> None:
    robot = Robot(SimParams(command_timeout_s=0.5))
    for _ in range(50):
        robot.command(Twist(0.3, 0.0))
        robot.advance(TICK_S)
    robot.faults.begin(SimFault.HANG, 5.0)
    for _ in range(15):
        robot.command(ZERO)
        robot.advance(TICK_S)
    assert robot.measured.linear > 0.2
    for _ in range(60):
        robot.advance(TICK_S)
    assert robot.measured == ZERO
