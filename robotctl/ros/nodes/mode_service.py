"""The mode on ROS: the services that request one, and the status topic."""

from __future__ import annotations

from asyncio import Future
from collections.abc import Callable
from math import nan
from operator import attrgetter
from pathlib import Path
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.service_introspection import ServiceIntrospectionState
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode
from std_srvs.srv import Trigger

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Reply
from robotctl.ros import qos
from robotctl.ros.message_types import OwnTopic
from robotctl.ros.nodes.node_services import ManagedNode
from robotctl.ros.session import Session

_TEMPERATURE = Path("/sys/class/thermal/thermal_zone0/temp")


ESTOP, SET_MODE = "estop", "set_mode"
"""The names of the services."""

STATUS = OwnTopic("robot_status", RobotStatus, qos.LATCHED)

CALLS = tuple(
    OwnTopic(f"{service}/_service_event", kind.Event, qos.SERVICE_EVENTS)
    for service, kind in ((SET_MODE, SetMode), (ESTOP, Trigger))
)
"""The introspection topic of each service, with its requests and responses."""


NODE_NAME = "mode_service"
"""The name of the node, before remapping."""


def names(session: Session) -> dict[str, str]:
    """Map "topic.robot_status", "service.set_mode" and "service.estop" to their full ROS names."""
    return {
        "topic.robot_status": session.resolve(STATUS.name, NODE_NAME),
        **{f"service.{name}": session.resolve(name, NODE_NAME) for name in (SET_MODE, ESTOP)},
    }


# Up to 64 may wait for the end of a ramp. The others wait until the e-stop latch is on the disk.
MAX_IN_WORK = 256
"""Limit on the requests that wait for the kernel's reply. Above it, all but an emergency stop are
refused as busy.
"""


class ModeService:
    """Node `mode_service`, with services `set_mode` and `estop` and the topic `robot_status`."""

    def __init__(
        self,
        session: Session,
        robot: str,
        request: Callable[[int, str], Future[Reply]],
        say: Callable[[Reply], str] = attrgetter("message"),
    ) -> None:
        """Call `request(mode number, source)`, which must return at once, for each request.

        `say` returns the text of a reply for the caller of the service.
        """
        self._request = request
        self._say = say
        self._in_work = 0
        self.node = session.node_of(ManagedNode, NODE_NAME)
        """The node. Its lifecycle state gates motion, but not its services."""
        self._publisher = STATUS.create_publisher(self.node)
        self._serve(Trigger, ESTOP, self._stop)
        self._serve(SetMode, SET_MODE, self._set_mode)
        self._message = RobotStatus(robot_name=robot)
        self.published = 0

    @property
    def status_topic(self) -> str:
        """The full name of the status topic."""
        return str(self._publisher.topic_name)

    def publish(self, mode: Mode, battery_level: float, is_connected: bool) -> None:
        """Publish the status. `battery_level` is 0 to 1 or NaN."""
        message = self._message
        message.mode = mode.value
        message.battery_level = battery_level
        message.cpu_temperature = _cpu_temperature()
        message.is_connected = is_connected
        self._publisher.publish(message)
        self.published += 1

    def _serve(self, kind: Any, name: str, handler: Callable[[Any, Any], Any]) -> None:
        # One queue for each service: a backlog of `set_mode` must not delay `estop`.
        service = self.node.create_service(
            kind,
            name,
            handler,
            qos_profile=qos.REQUESTS,
            callback_group=ReentrantCallbackGroup(),
        )
        service.configure_introspection(
            self.node.get_clock(), qos.SERVICE_EVENTS, ServiceIntrospectionState.CONTENTS
        )

    def _stop(self, _: Any, response: Any) -> Any:
        return self._answer(self._ask(Mode.EMERGENCY_STOP.value, ESTOP), response)

    def _set_mode(self, request: Any, response: Any) -> Any:
        mode = request.requested_mode
        if self._in_work >= MAX_IN_WORK and mode != Mode.EMERGENCY_STOP.value:
            response.success = False
            response.message = f"busy: {self._in_work} requests wait for their reply; try again"
            response.current_mode = self._message.mode
            return response
        return self._answer(self._ask(mode, SET_MODE), response)

    async def _answer(self, reply: Future[Reply], response: Any) -> Any:
        done = await reply
        response.success, response.message = done.ok, self._say(done)
        if isinstance(response, SetMode.Response):
            response.current_mode = done.mode.value
        return response

    def _ask(self, mode: int, service: str) -> Future[Reply]:
        """Submit a request at once, before the task that answers it starts."""
        namespace = self.node.get_namespace().rstrip("/")
        reply = self._request(mode, f"the ROS service {namespace}/{service}")
        self._in_work += 1
        reply.add_done_callback(self._done)
        return reply

    def _done(self, _: Future[Reply]) -> None:
        self._in_work -= 1


def _cpu_temperature() -> float:
    """Return the CPU temperature in degrees Celsius, NaN where the machine does not report it."""
    try:
        return int(_TEMPERATURE.read_text()) / 1000.0
    except (OSError, ValueError):
        return nan
