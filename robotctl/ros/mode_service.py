"""The ROS face of the mode: the service that asks for one, the topic that shows it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

from rclpy.service_introspection import ServiceIntrospectionState
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Reply
from robotctl.ros import qos
from robotctl.ros.session import Session

_TEMPERATURE = Path("/sys/class/thermal/thermal_zone0/temp")


@dataclass(frozen=True, slots=True)
class Shown:
    """What RobotStatus tells: mode, battery 0..1 or NaN, whether odometry is fresh."""

    mode: Mode
    battery_level: float
    is_connected: bool


class ModeService:
    """Node `mode_service`: SetMode on `set_mode`, RobotStatus on `robot_status`.

    Every call and its answer are published on `set_mode/_service_event`, too.
    """

    def __init__(
        self, session: Session, robot: str, request: Callable[[int, str], Awaitable[Reply]]
    ) -> None:
        """`request(mode number, source)` is asked for each call of the service."""
        self._request = request
        self._node = session.node("mode_service")
        self._publisher = self._node.create_publisher(RobotStatus, "robot_status", qos.LATCHED)
        self._service = self._node.create_service(SetMode, "set_mode", self._answer)
        self._service.configure_introspection(
            self._node.get_clock(), qos.SERVICE_EVENTS, ServiceIntrospectionState.CONTENTS
        )
        self._message = RobotStatus(robot_name=robot)
        self.published = 0

    @property
    def status_topic(self) -> str:
        """The full name of the status topic."""
        return str(self._publisher.topic_name)

    def publish(self, shown: Shown) -> None:
        """Publish the status."""
        message = self._message
        message.mode = shown.mode.value
        message.battery_level = shown.battery_level
        message.cpu_temperature = _cpu_temperature()
        message.is_connected = shown.is_connected
        self._publisher.publish(message)
        self.published += 1

    async def _answer(self, request: Any, response: Any) -> Any:
        reply = await self._request(
            request.requested_mode,
            f"the ROS service {self._node.get_namespace().rstrip('/')}/set_mode",
        )
        response.success = reply.ok
        response.message = reply.message
        response.current_mode = reply.mode.value
        return response


def _cpu_temperature() -> float:
    """Return degrees Celsius, NaN where the machine does not say."""
    try:
        return int(_TEMPERATURE.read_text()) / 1000.0
    except (OSError, ValueError):
        return nan
