"""What comes in from ROS and from the recorder, as events of the kernel."""

from __future__ import annotations

import asyncio
import time

from robotctl.daemon.control import Control
from robotctl.daemon.motion import Motion
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    FaultCleared,
    FaultReported,
    ModeRequested,
    Odometry,
    OdomReceived,
    Reply,
)
from robotctl.ros.velocity_publisher import VelocityPublisher


class Inputs:
    """Every method belongs to the loop's thread."""

    def __init__(self, control: Control, motion: Motion, velocity: VelocityPublisher) -> None:
        self._control = control
        self._motion = motion
        self._velocity = velocity

    def odometry(self, odometry: Odometry) -> None:
        """The robot measured where it is."""
        self._control.dispatch(OdomReceived(time.monotonic_ns(), odometry))
        if self._control.state.drive is not None:
            self._motion.drove_to(odometry.pose)

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

    def stalled(self, detail: str) -> None:
        """The loop turns again after a stall: stop by the rules, then let commands through."""
        self._control.dispatch(FaultReported(time.monotonic_ns(), Cause.LOOP_STALLED, detail))
        self._control.dispatch(FaultCleared(time.monotonic_ns(), Cause.LOOP_STALLED))
        self._velocity.open_gate()
