"""A planner, and a stand-in for twist_mux: it passes a velocity on while its lock is open."""

from __future__ import annotations

from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool

from tests.support.lines import obey
from tests.support.spinning import spinning

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PERIOD_S = 0.02


class MuxPeer:
    def __init__(self) -> None:
        self.node = Node("planner")
        self.locked: bool | None = None
        self.passed = 0
        self._planning: Any = None

    def want(self, topic: str, linear: float) -> None:
        """Publish a velocity on a topic every 20 ms, as a planner does, until `rest`."""
        publisher = self.node.create_publisher(Twist, topic, 10)
        message = Twist()
        message.linear.x = linear
        self._planning = self.node.create_timer(PERIOD_S, lambda: publisher.publish(message))

    def rest(self) -> None:
        """Publish no more velocities."""
        self.node.destroy_timer(self._planning)

    def mux(self, lock: str, wanted: str) -> None:
        """Take a latched Bool as a lock, and pass on what is wanted while it is open."""
        # rclpy's types allow callbacks of one argument only.
        take_lock: Any = self._take_lock
        take: Any = self._take
        self.node.create_subscription(Bool, lock, take_lock, LATCHED)
        self.node.create_subscription(Twist, wanted, take, 10)

    def state(self) -> dict[str, Any]:
        """Return what the lock says, None before its first message, and what was passed on."""
        return {"locked": self.locked, "passed": self.passed}

    def _take_lock(self, message: Any) -> None:
        self.locked = message.data

    def _take(self, message: Any) -> None:
        self.passed += self.locked is False


def main() -> None:
    rclpy.init(args=[])
    peer = MuxPeer()
    with spinning(peer.node):
        obey(peer)
    peer.node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
