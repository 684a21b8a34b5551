"""Publishes marks: texts by which a moment is found again in the recording."""

from __future__ import annotations

import logging

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from robotctl.ros.messages import qos
from robotctl.ros.messages.own_topic import OwnTopic
from robotctl.ros.session import Session

TOPIC = OwnTopic("robotctl/marks", String, qos.MARK)

_log = logging.getLogger(__name__)


class MarkPublisher:
    """Publishes on `TOPIC`, as a part of the hidden node."""

    def __init__(self, session: Session) -> None:
        node = session.helper()
        self._publisher = TOPIC.create_publisher(node)

    def publish(self, text: str) -> bytes:
        """Publish a mark and return it serialized.

        A failure is logged only: the mark is recorded anyway.
        """
        serialized = bytes(serialize_message(String(data=text)))
        try:
            self._publisher.publish(serialized)
        except _rclpy.RCLError as error:
            _log.warning("the mark cannot be published: %s", error)
        return serialized
