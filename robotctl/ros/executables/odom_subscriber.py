# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""Node `odom_subscriber` of the first-package tutorial. It logs every tenth position."""

from __future__ import annotations

from typing import Any

from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node

from robotctl.ros import qos
from robotctl.ros.executables.process import LOGGER_SERVICES, run_node

LOG_EVERY = 10


class OdomSubscriber(Node):
    """Counts the messages on `odom`, and logs every tenth position."""

    def __init__(self, context: Context | None = None, **options: Any) -> None:
        """Create the node and its subscription. `options` are those of rclpy's Node."""
        super().__init__("odom_subscriber", context=context, **{**LOGGER_SERVICES, **options})
        self._messages = 0
        self.create_subscription(Odometry, "odom", self._take, qos.SENSOR)
        self.get_logger().info("Odometry Subscriber Node started")

    def get_total_messages(self) -> int:
        """Return the number of received messages."""
        return self._messages

    def _take(self, message: Odometry) -> None:
        self._messages += 1
        if self._messages % LOG_EVERY == 0:
            at = message.pose.pose.position
            self.get_logger().info(f"Position: x={at.x:.2f}, y={at.y:.2f}, z={at.z:.2f}")
            self.get_logger().info(f"Messages received: {self._messages}")


def main() -> int:
    """Run the node until Ctrl-C, and return the exit code."""
    return run_node(OdomSubscriber)
