# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""Node `velocity_publisher` of the first-package tutorial. By default it moves no real robot."""

from __future__ import annotations

import math
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node

from robotctl.base.domains import wider_discovery
from robotctl.kernel.types import ZERO
from robotctl.kernel.types import Twist as Velocity
from robotctl.ros.executables.process import LOGGER_SERVICES, run_node
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.endpoints import TOOL_NODES, gid_of, shown_name
from robotctl.ros.message_types import PLAIN
from robotctl.ros.nodes.velocity_publisher import (
    MONITORS,
    NODE_NAME,
    command_topic,
    publishing_line,
)

STEP_S = 0.5
"""The time between two messages of the tutorial."""

QUIET_STEPS = 8
"""The number of steps with zeros at first (4 s), until the other nodes are discovered."""

STEPS_PER_MPS = 10
MAX_STEPS = 20
MAX_LINEAR_MPS = 2.0
MAX_ANGULAR_RPS = 2.0

OWN_LISTENERS = (*MONITORS, "simulated_robot")
"""Nodes of robotctl that receive commands and move no real robot."""

ACKNOWLEDGED_S = 1.0
"""How long `stop` waits for reliable subscribers to acknowledge the last zero."""


def sweep_mps(number: int) -> float:
    """Return speed `number` (from 0) of the sweep 0.1, 0.2 ... 2.0, 1.9 ... -2.0 ... 0.0 m/s."""
    place = (number + 1 + MAX_STEPS) % (4 * MAX_STEPS)
    return (MAX_STEPS - abs(place - 2 * MAX_STEPS)) / STEPS_PER_MPS


class VelocityPublisher(Node):
    """Publishes the tutorial's sweep of velocities on `cmd_vel`, after 4 s of zeros.

    It publishes zeros while another node publishes on the topic, while a node that may be a robot
    subscribes, or if discovery reaches beyond this machine. The parameter `sweep` overrides these
    checks: true sweeps, false publishes zeros.
    """

    def __init__(self, context: Context | None = None, **options: Any) -> None:
        """Create the node and its timer. `options` are those of rclpy's Node."""
        super().__init__(NODE_NAME, context=context, **{**LOGGER_SERVICES, **options})
        self._may_sweep = self._sweep_parameter()
        self._steps = 0
        self._swept = 0
        self._asked: tuple[float, float] | None = None
        self._said = ""
        self._publisher = command_topic("cmd_vel").create_publisher(self)
        self._own_gid = gid_of(self._publisher)
        # The steady clock: zeros must go out even while a simulation's /clock stands still.
        self.create_timer(STEP_S, self._step, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info("Velocity Publisher Node started")

    def set_velocity(self, linear: float, angular: float) -> None:
        """Publish this velocity instead of the sweep, limited to +-2 m/s and +-2 rad/s.

        Raises:
            ValueError: A number is not finite.
        """
        if not math.isfinite(linear) or not math.isfinite(angular):
            raise ValueError(f"a velocity is finite, not {linear}, {angular}")
        limited = (
            min(max(float(linear), -MAX_LINEAR_MPS), MAX_LINEAR_MPS),
            min(max(float(angular), -MAX_ANGULAR_RPS), MAX_ANGULAR_RPS),
        )
        if limited != (linear, angular):
            self.get_logger().warning(
                f"limited to linear.x={limited[0]}, angular.z={limited[1]}: "
                f"at most {MAX_LINEAR_MPS} m/s and {MAX_ANGULAR_RPS} rad/s"
            )
        self._asked = limited

    def obstacle(self) -> str:
        """Return the reason against a sweep now, or "" if there is none."""
        other = self._other_publisher()
        if other:
            return other
        topic = self._topic
        for each in endpoints.subscriptions(self, topic):
            if each.node_name not in OWN_LISTENERS and not each.node_name.startswith(TOOL_NODES):
                return f"{shown_name(each)} takes {topic} and may be a robot"
        wider = wider_discovery()
        return f"discovery reaches beyond this machine ({wider})" if wider else ""

    def stop(self) -> None:
        """Publish zero velocity, and wait at most ACKNOWLEDGED_S for reliable subscribers."""
        self._send(ZERO)
        self._publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_S))

    @property
    def _topic(self) -> str:
        return str(self._publisher.topic_name)

    def _sweep_parameter(self) -> bool | None:
        """Declare the parameter `sweep`, and return its value, or None if it is not set."""
        dynamic = ParameterDescriptor(
            description="true: sweep anyway; false: never; unset: where no robot can be",
            dynamic_typing=True,
            read_only=True,
        )
        given = self.declare_parameter("sweep", None, dynamic)
        if not isinstance(given.value, bool | None):
            raise InvalidParameterValueException("sweep", given.value, "sweep is true or false")
        return given.value

    def _send(self, velocity: Velocity) -> None:
        self._publisher.publish(PLAIN.encode(velocity))

    def _other_publisher(self) -> str:
        """Return a sentence that names another publisher of the topic, or "" if there is none."""
        if self.count_publishers(self._topic) > 1:
            for each in endpoints.publishers(self, self._topic):
                if each.gid != self._own_gid:
                    return f"{shown_name(each)} publishes {self._topic} too"
        return ""

    def _step(self) -> None:
        self._steps += 1
        velocity = Velocity(*self._wanted())
        self._send(velocity)
        self.get_logger().info(publishing_line(velocity))

    def _wanted(self) -> tuple[float, float]:
        if self._asked is not None:
            return self._asked
        if self._steps <= QUIET_STEPS:
            return 0.0, 0.0
        if self._may_sweep is False:
            self._say("sweep is false: publishing zeros")
            return 0.0, 0.0
        why = "" if self._may_sweep else self.obstacle()
        cure = "sweep all the same: --ros-args -p sweep:=true"
        self._say(f"{why}: publishing zeros ({cure})" if why else "")
        if why:
            self._swept = 0
            return 0.0, 0.0
        self._swept += 1
        return sweep_mps(self._swept - 1), 0.0

    def _say(self, why: str) -> None:
        """Log the reason `why` zeros are published, if it is new. "" means a running sweep."""
        if why != self._said:
            self._said = why
            if why:
                self.get_logger().warning(why)


def main() -> int:
    """Run the node until Ctrl-C, and return the exit code."""
    return run_node(VelocityPublisher, VelocityPublisher.stop)
