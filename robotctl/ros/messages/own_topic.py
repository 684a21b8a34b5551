"""A topic of robotctl's own: the role that publishes it declares it, and the tap reads that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from robotctl.ros.messages.classes import type_name_of
from robotctl.ros.messages.no_events import NO_PUBLISHER_EVENTS


@dataclass(frozen=True, slots=True)
class OwnTopic:
    """Name, message class and offered QoS; the name is relative to the robot's namespace."""

    name: str
    message_class: Any
    qos: QoSProfile

    @property
    def type_name(self) -> str:
        """The type as `package/msg/Name`."""
        return type_name_of(self.message_class)

    def create_publisher(
        self, node: Node, events: PublisherEventCallbacks = NO_PUBLISHER_EVENTS
    ) -> Publisher:
        """Create the node's publisher of the topic."""
        return node.create_publisher(
            self.message_class, self.name, self.qos, event_callbacks=events
        )
