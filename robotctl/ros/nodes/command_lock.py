"""A latched Bool that a twist_mux takes as a lock: true while robotctl has stopped the robot."""

from __future__ import annotations

from rclpy.node import Node
from std_msgs.msg import Bool

from robotctl.kernel.modes import Mode
from robotctl.ros.messages import qos
from robotctl.ros.messages.classes import OwnTopic

LOCKING = frozenset({Mode.ERROR, Mode.EMERGENCY_STOP})
"""The modes in which no node may command the robot."""


class CommandLock:
    """Publishes on the lock topic, as a part of `node`; nothing where the topic is ""."""

    def __init__(self, node: Node, topic: str) -> None:
        own = OwnTopic(topic, Bool, qos.LATCHED)
        self._publisher = own.create_publisher(node) if topic else None

    def show(self, mode: Mode) -> None:
        """Tell whether the mode locks."""
        if self._publisher is not None:
            self._publisher.publish(Bool(data=mode in LOCKING))
