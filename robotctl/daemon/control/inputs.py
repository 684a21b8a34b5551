"""What comes in from ROS and from the recorder, as events of the kernel."""

from __future__ import annotations

import asyncio
import time

from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    FaultReported,
    ModeRequested,
    Odometry,
    OdometrySourceFound,
    OdomReceived,
    Reply,
)


class Inputs:
    """Every method belongs to the loop's thread."""

    def __init__(self, control: Control, robot_report: RobotReport) -> None:
        self._control = control
        self._robot_report = robot_report

    def odometry(self, odometry: Odometry, source: int, sequence: int) -> None:
        """Take a measurement of where the robot is, by the publisher with this number."""
        self._control.dispatch(OdomReceived(time.monotonic_ns(), odometry, source, sequence))
        state = self._control.state
        if state.drive is not None and state.health.odometry is odometry:  # it was not dropped
            self._robot_report.drove_to(odometry.pose)

    def odometry_source(self, source: int, gid: str, name: str) -> None:
        """Take note of a publisher of odometry that was not heard before."""
        self._control.dispatch(OdometrySourceFound(time.monotonic_ns(), source, gid, name))

    def battery(self, level: float) -> None:
        """The robot measured its battery."""
        self._control.dispatch(BatteryReceived(time.monotonic_ns(), level))

    def service_call(self, requested: int, source: str) -> asyncio.Future[Reply]:
        """Let the kernel decide now on a mode that a ROS node asks for; return its reply to be."""
        request_id = self._control.new_request_id()
        return self._control.begin(
            ModeRequested(time.monotonic_ns(), request_id, requested, source)
        )

    def recorder_failed(self, detail: str) -> None:
        """Nothing is recorded any more, and the robot is not to go on so."""
        self._control.dispatch(FaultReported(time.monotonic_ns(), Cause.RECORDER_FAILED, detail))
