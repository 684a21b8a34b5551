"""Input from ROS and from the recorder, as events for the kernel."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.kernel.lifecycle import LifecycleChanged, LifecycleState
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    FaultReported,
    GuardedCommandReceived,
    ModeRequested,
    Odometry,
    OdometrySourceFound,
    OdomReceived,
    Reply,
    SafetyInputReceived,
    ScanReceived,
    Twist,
)


class Inputs:
    """The inputs; each method is called in the loop's thread."""

    def __init__(
        self,
        control: Control,
        robot_report: RobotReport,
        is_remote: Callable[[], bool] = lambda: False,
    ) -> None:
        """`is_remote()` returns whether the present request may come from another host."""
        self._is_remote = is_remote
        self._control = control
        self._robot_report = robot_report

    def odometry(self, odometry: Odometry, source: int, sequence: int) -> None:
        """Handle an odometry sample of the publisher with the number `source`."""
        self._control.dispatch(OdomReceived(time.monotonic_ns(), odometry, source, sequence))
        state = self._control.state
        if state.drive is not None and state.health.odometry is odometry:  # it was not dropped
            self._robot_report.drove_to(odometry.pose)

    def odometry_source(self, source: int, gid: str, name: str, frame: str) -> None:
        """Handle the first sample of a new publisher of odometry, or another frame of one."""
        self._control.dispatch(OdometrySourceFound(time.monotonic_ns(), source, gid, name, frame))

    def battery(self, level: float, publisher: str, sequence: int) -> None:
        """Handle a battery level from 0 to 1, NaN if unknown."""
        self._control.dispatch(BatteryReceived(time.monotonic_ns(), level, publisher, sequence))

    def safety_input(
        self, kind: SafetyInput, value: float, detail: str, publisher: str, sequence: int
    ) -> None:
        """Handle a message of a safety input."""
        now = time.monotonic_ns()
        self._control.dispatch(SafetyInputReceived(now, kind, value, detail, publisher, sequence))

    def scan(self, sectors: tuple[float, ...], publisher: str, sequence: int) -> None:
        """Handle a laser scan: the nearest ranges by direction, () if it is unreadable."""
        self._control.dispatch(ScanReceived(time.monotonic_ns(), sectors, publisher, sequence))

    def guarded_command(self, twist: Twist, publisher: str, sequence: int) -> None:
        """Handle a velocity that another node wants; it counts while the robot is guarded."""
        if self._control.state.guarded is not None:
            now = time.monotonic_ns()
            self._control.dispatch(GuardedCommandReceived(now, twist, publisher, sequence))

    def lifecycle(self, state: LifecycleState, source: str) -> None:
        """Handle a transition of the node that gates motion; one that is not active ramps down."""
        present = self._control.state
        if state is present.health.lifecycle:
            return
        self._control.dispatch(LifecycleChanged(time.monotonic_ns(), state, source))
        if state is not LifecycleState.ACTIVE and present.mode is Mode.MOVING:
            self.service_call(Mode.IDLE.value, source)

    def service_call(self, requested: int, source: str) -> asyncio.Future[Reply]:
        """Dispatch the mode request of a ROS node; return the future of its reply."""
        request_id = self._control.new_request_id()
        return self._control.begin(
            ModeRequested(
                time.monotonic_ns(), request_id, requested, source, remote=self._is_remote()
            )
        )

    def recorder_failed(self, detail: str) -> None:
        """Handle the failure of a recorder without which the robot must not drive."""
        self._control.dispatch(FaultReported(time.monotonic_ns(), Cause.RECORDER_FAILED, detail))
