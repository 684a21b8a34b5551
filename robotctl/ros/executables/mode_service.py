# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""Node `mode_service` of the first-package tutorial, for a program of your own: modes alone.

The executable of this name is `robotctl.daemon.mode_service`, which owns, drives and records a
robot. This node uses the same table of transitions, but sends no commands, so it leaves MOVING as
soon as a robot joins the domain.
"""

from __future__ import annotations

from math import nan
from typing import Any

from rclpy.context import Context
from rclpy.node import Node
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode
from std_srvs.srv import Trigger

from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode
from robotctl.ros.executables.process import LOGGER_SERVICES
from robotctl.ros.messages import qos
from robotctl.ros.nodes.mode_service import ESTOP, SET_MODE, STATUS

LOOK_S = 0.1
"""The time between two looks for a robot on the graph."""

STATUS_S = 1.0

NO_ROBOT = "no robot, no odometry and no recorder here: these start conditions are switched off"


class ModeService(Node):
    """Serves `set_mode` and `estop`, and publishes `robot_status`, without a robot."""

    def __init__(self, context: Context | None = None, **options: Any) -> None:
        """Create the node in mode IDLE; `options` are those of rclpy's Node."""
        super().__init__("mode_service", context=context, **{**LOGGER_SERVICES, **options})
        self.mode = Mode.IDLE
        self._status = STATUS.create_publisher(self)
        self._services = [
            self.create_service(SetMode, SET_MODE, self._set_mode, qos_profile=qos.REQUESTS),
            self.create_service(Trigger, ESTOP, self._estop, qos_profile=qos.REQUESTS),
        ]
        self.create_timer(LOOK_S, self._look_for_robot)
        self.create_timer(STATUS_S, self._publish)
        self._publish()
        self.get_logger().info("Mode Service Node started")
        self.get_logger().warning(f"{NO_ROBOT}; to drive one: robotctl start")

    def robot(self) -> str:
        """Return a sentence on the robot that is on the graph, "" where there is none."""
        if self.count_publishers("odom"):
            return "odometry is published"
        if self.count_subscribers("cmd_vel"):
            return "velocity commands are taken"
        return ""

    def request(self, number: int) -> tuple[bool, str]:
        """Request the mode of this number; return whether it was granted, and a sentence."""
        if number not in [mode.value for mode in Mode]:
            return False, f"no mode {number}: use 0 to {max(Mode).value}"
        wanted = Mode(number)
        step = TRANSITIONS[self.mode, REQUESTS[wanted]]
        if step.guard is Guard.NEVER:
            return False, f"refused in {self.mode.name}: ask for IDLE first"
        robot = self.robot() if step.guard is Guard.START_CONDITIONS else ""
        if robot:
            return False, f"{robot}, and this service drives no robot: robotctl start does"
        self._go(step.target)
        return True, f"Mode changed to {self.mode.name}"

    def _set_mode(self, request: Any, response: Any) -> Any:
        response.success, response.message = self.request(request.requested_mode)
        response.current_mode = self.mode.value
        return response

    def _estop(self, _: Any, response: Any) -> Any:
        response.success, response.message = self.request(Mode.EMERGENCY_STOP.value)
        return response

    def _look_for_robot(self) -> None:
        robot = self.robot() if self.mode is Mode.MOVING else ""
        if robot:
            self._go(Mode.IDLE)
            self.get_logger().error(f"{robot}: back to IDLE, because this service drives no robot")

    def _go(self, mode: Mode) -> None:
        if mode is not self.mode:
            self.get_logger().info(f"{self.mode.name} -> {mode.name}")
            self.mode = mode
            self._publish()

    def _publish(self) -> None:
        self._status.publish(
            RobotStatus(
                robot_name=self.get_namespace().strip("/") or "robot",
                mode=self.mode.value,
                battery_level=nan,
                cpu_temperature=nan,
                is_connected=bool(self.count_publishers("odom")),
            )
        )
