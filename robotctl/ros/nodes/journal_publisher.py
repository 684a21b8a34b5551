"""Publishes the journal on ROS, so that decisions can be watched live."""

from __future__ import annotations

import logging
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
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
        # An event when a subscription comes or goes: asking 150 times a second would cost more.
        events = PublisherEventCallbacks(matched=self._matched, use_default_callbacks=False)
        self._publisher = TOPIC.create_publisher(node, events)
        self._subscriptions = 0
        self._failing = False

    def publish(self, serialized: bytes) -> None:
        """Publish one entry if there is a subscriber.

        A failure is logged only: no decision depends on it.
        """
        if not self._subscriptions:
            return  # the topic is volatile: no later subscriber gets it
        try:
            self._publisher.publish(serialized)
            self._failing = False
        except _rclpy.RCLError as error:
            if not self._failing:
                _log.warning("the journal cannot be published: %s", error)
            self._failing = True

    def _matched(self, status: Any) -> None:
        self._subscriptions = status.current_count
