"""Publishes the newest head of the seal, so that another machine can keep it."""

from __future__ import annotations

import logging

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from robotctl.ros.messages import qos
from robotctl.ros.messages.own_topic import OwnTopic
from robotctl.ros.session import Session

TOPIC = OwnTopic("robotctl/head", String, qos.LATCHED)

_log = logging.getLogger(__name__)


class HeadPublisher:
    """Publishes on `TOPIC`, from the hidden node."""

    def __init__(self, session: Session) -> None:
        node = session.helper()
        self._publisher = TOPIC.create_publisher(node)

    def publish(self, digest: str) -> None:
        """Publish a head in hex; a failure is logged only."""
        try:
            self._publisher.publish(bytes(serialize_message(String(data=digest))))
        except _rclpy.RCLError as error:
            _log.warning("the head of the seal cannot be published: %s", error)
