# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""Node `velocity_publisher` of the first-package tutorial: a Twist every 0.5 s.

The speeds sweep only where they cannot move a real robot: see `VelocityPublisher.obstacle`.
"""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.node import Node

from robotctl.domains import discovery_range, is_on_this_machine_only
from robotctl.printable import short_name
from robotctl.ros.executables.process import run_node
from robotctl.ros.executables.sweep import sweep_mps
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.publishers import full_name, gid_of
from robotctl.ros.nodes.velocity_publisher import NODE_NAME, command_topic
from robotctl.ros.session import RECORDER_NODE

PERIOD_S = 0.5
QUIET_TICKS = 8
"""The first ticks, 4 s of zeros, during which other nodes are discovered."""

MAX_LINEAR_MPS = 2.0
MAX_ANGULAR_RPS = 2.0

OWN_LISTENERS = (RECORDER_NODE, NODE_NAME, "simulated_robot")
"""Nodes of robotctl that receive commands and move no real robot."""


class VelocityPublisher(Node):
    """Publishes `cmd_vel`: zeros for 4 s, then a sweep from -2 to 2 m/s in steps of 0.1.

    It publishes zeros instead, and logs why, while another node publishes the topic, while one that
    may be a robot subscribes to it, or where discovery reaches beyond this machine. With the
    parameter `sweep` set to true it sweeps anyway. The method `set_velocity` ends the sweep.
    """

    def __init__(self, context: Context | None = None, **options: Any) -> None:
        """Create the node and its timer; `options` are those of rclpy's Node."""
        super().__init__(NODE_NAME, context=context, **options)
        self.declare_parameter("sweep", False)
        self._publisher = command_topic("cmd_vel").create_publisher(self)
        self._ticks = 0
        self._steps = 0
        self._asked: tuple[float, float] | None = None
        self._said = ""
        self.create_timer(PERIOD_S, self._tick)
        self.get_logger().info("Velocity Publisher Node started")

    def set_velocity(self, linear: float, angular: float) -> None:
        """Publish this velocity [m/s, rad/s] from now on, within +-2 m/s and +-2 rad/s.

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
        """Return why the sweep may not run now, "" where it may."""
        own, topic = gid_of(self._publisher), str(self._publisher.topic_name)
        for each in endpoints.publishers(self, topic):
            if each.gid != own:
                return f"{_name(each)} publishes {topic} too"
        for each in endpoints.subscriptions(self, topic):
            if each.node_name not in OWN_LISTENERS and not each.node_name.startswith("_ros2cli"):
                return f"{_name(each)} takes {topic} and may be a robot"
        if not is_on_this_machine_only():
            return f"discovery reaches beyond this machine ({discovery_range()})"
        return ""

    def stop(self) -> None:
        """Publish a zero, and only zeros from now on."""
        self._asked = (0.0, 0.0)
        self._publisher.publish(Twist())

    def _tick(self) -> None:
        self._ticks += 1
        linear, angular = self._velocity()
        message = Twist()
        message.linear.x, message.angular.z = linear, angular
        self._publisher.publish(message)
        self.get_logger().info(f"Publishing: linear.x={linear}, angular.z={angular}")

    def _velocity(self) -> tuple[float, float]:
        if self._asked is not None:
            return self._asked
        if self._ticks <= QUIET_TICKS:
            return 0.0, 0.0
        why = "" if self.get_parameter("sweep").value else self.obstacle()
        if why != self._said:
            self._said = why
            if why:
                self.get_logger().warning(
                    f"{why}: publishing zeros (sweep all the same: --ros-args -p sweep:=true)"
                )
        if why:
            self._steps = 0
            return 0.0, 0.0
        self._steps += 1
        return sweep_mps(self._steps - 1), 0.0


def _name(endpoint: endpoints.Endpoint) -> str:
    return short_name(full_name(endpoint)) or "a node whose name is not known yet"


def main() -> int:
    """Run the node until Ctrl-C; return the exit code."""
    return run_node(VelocityPublisher, VelocityPublisher.stop)
