# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""Node `mode_service` of the first-package tutorial. It serves modes and drives no robot.

It refuses MOVING, and leaves MOVING for IDLE, while a robot may be in the domain.
"""

from __future__ import annotations

import threading
import time
from functools import partial
from math import nan
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.context import Context
from rclpy.node import Node
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode
from std_srvs.srv import Trigger

from robotctl.base.domains import is_certainly_empty, requested_domain
from robotctl.base.errors import Refused, UsageError
from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode
from robotctl.ros import qos
from robotctl.ros.executables.process import LOGGER_SERVICES, run_node
from robotctl.ros.graph.discovery import Discovery
from robotctl.ros.nodes.mode_service import ESTOP, NODE_NAME, SET_MODE, STATUS

LOOK_S = 0.1
"""The time between two looks for a robot in the graph."""

STATUS_S = 1.0

GIVEN_UP = ("standalone", "config", "recordings")
"""Parameters of earlier versions, which are an error now."""

DAEMON = "use: robotctl start --config FILE --recordings DIR"
OTHER = "ask that one, or give this one another namespace or ROS domain"

DISCOVERY_S = 4.0
"""Limit on the time of discovery, which takes 2.6 s at worst on one machine (Fast DDS)."""

QUIET_S = 0.1
"""Discovery is complete when no endpoint has changed for this time."""

NO_ROBOT = "no robot, no odometry and no recorder here: these start conditions are switched off"


class ModeService(Node):
    """Serves `set_mode` and `estop`, and publishes `robot_status`, without a robot."""

    def __init__(self, context: Context | None = None, **options: Any) -> None:
        """Create the node in mode IDLE. `options` are those of rclpy's Node."""
        super().__init__(NODE_NAME, context=context, **{**LOGGER_SERVICES, **options})
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
        """Return why a robot may be in the domain, such as "odometry is published", or ""."""
        if self.count_publishers("odom"):
            return "odometry is published"
        if self.count_subscribers("cmd_vel"):
            return "velocity commands are taken"
        return ""

    def request(self, number: int) -> tuple[bool, str]:
        """Request a mode by its number. Return whether it was granted, and a sentence about it."""
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


def main() -> int:
    """Run the node until Ctrl-C, and return the exit code."""
    alone = is_certainly_empty(requested_domain(None) or 0)
    return run_node(partial(_only_service, alone))


def _only_service(alone: bool, context: Context) -> ModeService:
    """Create the node if no other node serves `set_mode`. Wait for discovery unless `alone`.

    Raises:
        UsageError: A parameter of `GIVEN_UP` is set.
        Refused: Another node serves `set_mode`.
    """
    probe = Node(NODE_NAME, context=context, start_parameter_services=False)
    try:
        dynamic = ParameterDescriptor(dynamic_typing=True)
        for name in GIVEN_UP:
            if probe.declare_parameter(name, None, dynamic).value is not None:
                raise UsageError(f"{name}: this node drives and records no robot", DAEMON)
        if not alone:
            discovery = Discovery(probe, context.get_domain_id())
            discovery.wait(QUIET_S, time.monotonic() + DISCOVERY_S, threading.Event())
            discovery.close()
        if probe.count_services(SET_MODE):
            raise Refused(f"{probe.resolve_service_name(SET_MODE)} is served already", OTHER)
    finally:
        probe.destroy_node()
    return ModeService(context)
