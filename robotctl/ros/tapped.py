"""The subscription of one recorded topic."""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile

from robotctl.ros.message_types import message_class
from robotctl.ros.raw import RawTap, Sink

LATENCY_S = 0.05
"""How long messages may wait to be taken together: waking costs more than taking. Their times
are the middleware's, so nothing shows in the recording."""


class TappedSubscription:
    """Hands the messages of a topic to its sink until it is closed."""

    def __init__(
        self, node: Node, topic: str, type_name: str, sink: Sink, requested: QoSProfile
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.publishers = 0
        """How many there were when somebody last looked."""

        self.abandoned_since: float | None = None
        """Since when on the steady clock [s] nobody publishes it, None while somebody does."""

        self._node = node
        self._sink = sink
        self._requested = requested
        self._subscription = self._create()

    def adapt(self, requested: QoSProfile) -> None:
        """Ask for something else, if it is; what is sent meanwhile is lost and counted so."""
        if requested != self._requested:
            self.close()
            self._requested = requested
            self._subscription = self._create()

    def close(self) -> None:
        """Subscribe no more."""
        self._node.destroy_subscription(self._subscription)

    def _create(self) -> Any:
        # rclpy's own types know a callback of one argument only.
        tap: Any = RawTap(self._sink, latency_s=LATENCY_S)
        return self._node.create_subscription(
            message_class(self.type_name),
            self.topic,
            tap,
            self._requested,
            # No events: each would take a file of its own, and what they tell is seen in the graph.
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
