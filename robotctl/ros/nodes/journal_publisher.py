"""Publishes the journal on ROS, so that decisions can be watched live."""

from __future__ import annotations

import logging

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from robot_controller.msg import JournalEntry

from robotctl.ros.messages import qos
from robotctl.ros.messages.own_topic import OwnTopic
from robotctl.ros.session import Session

TOPIC = OwnTopic("robotctl/journal", JournalEntry, qos.JOURNAL)

_log = logging.getLogger(__name__)


class JournalPublisher:
    """Publishes entries that are serialized already, as a part of the hidden node."""

    def __init__(self, session: Session) -> None:
        node = session.helper()
        self._publisher = TOPIC.create_publisher(node)
        self._failing = False

    def publish(self, serialized: bytes) -> None:
        """Publish one entry if there is a subscriber.

        A failure is logged only: no decision depends on it.
        """
        try:
            if not self._publisher.get_subscription_count():
                return  # the topic is volatile: no later subscriber gets it
            self._publisher.publish(serialized)
            self._failing = False
        except _rclpy.RCLError as error:
            if not self._failing:
                _log.warning("the journal cannot be published: %s", error)
            self._failing = True
