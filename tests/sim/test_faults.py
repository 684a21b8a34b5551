"""Each fault of the simulated robot stops a drive for its own cause, and ends after its time."""

from __future__ import annotations

import pytest

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
from robotctl.sim.robot import Robot, SimFault, SimParams
from robotctl.testing.kernels import TICK_NS, Bench, moving

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


@pytest.mark.parametrize("fault", SimFault)
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
