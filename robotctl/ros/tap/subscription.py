"""The subscription of one recorded topic."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from robotctl.ros.executor import RawTap, ViewSink
from robotctl.ros.messages import qos
from robotctl.ros.messages.classes import NO_SUBSCRIPTION_EVENTS, message_class
from robotctl.ros.messages.type_definition import holds_bytes
from robotctl.ros.tap.latched import LatchedMerge

LATENCY_S = 0.05
"""How long messages are collected before they are taken together, which costs less. Their time
stamps are the middleware's, so the recording does not show the delay."""

Requests = tuple[QoSProfile, QoSProfile | None]
"""The QoS requested for all messages, and that of a second subscription for latched ones."""


class TappedSubscription:
    """Hands the messages of one topic to its sink until it is closed."""

    def __init__(
        self,
        node: Node,
        topic: str,
        type_name: str,
        sink: ViewSink,
        offered: Sequence[QoSProfile],
        latency_s: float = LATENCY_S,
    ) -> None:
        """Subscribe to publishers that offer these profiles; take messages `latency_s` late."""
        self.topic = topic
        self.type_name = type_name
        self.publishers = 0
        """The number of publishers at the last look."""

        self.abandoned_since: float | None = None
        """When the last publisher went, on the steady clock [s]; None while there is one."""

        self._node = node
        self._latency_s = latency_s
        self._sink = sink
        self._merge = LatchedMerge(sink)
        self._subscriptions: list[Any] = []
        self._requests = self._requests_for(offered)
        self._subscribe(self._requests)

    @property
    def is_latched(self) -> bool:
        """Whether a new subscription gets messages that were sent before."""
        requested, latched = self._requests
        return latched is not None or requested.durability is DurabilityPolicy.TRANSIENT_LOCAL

    def adapt(self, offered: Sequence[QoSProfile]) -> None:
        """Subscribe again where publishers now offer other profiles.

        Messages that are sent meanwhile are lost, and counted as lost.

        Raises:
            Exception: rclpy could not subscribe; the next call tries again.
        """
        requests = self._requests_for(offered)
        if requests != self._requests or not self._subscriptions:
            self.close()
            self._subscribe(requests)
            self._requests = requests

    def close(self) -> None:
        """Destroy the subscriptions."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def _subscribe(self, requests: Requests) -> None:
        self._merge.restart()
        try:
            for sink, requested in self._sinks(requests):
                self._subscriptions.append(self._create(sink, requested))
        except BaseException:
            self.close()  # one alone would record a part of the messages as if it were all
            raise

    def _sinks(self, requests: Requests) -> Iterator[tuple[ViewSink, QoSProfile]]:
        requested, latched = requests
        if latched is not None:
            yield self._merge.live, requested
            yield self._merge.latched, latched
        elif requested.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            yield self._merge.latched, requested
        else:
            yield self._sink, requested

    def _requests_for(self, offered: Sequence[QoSProfile]) -> Requests:
        bulky = holds_bytes(self.type_name)
        return qos.recording(offered, bulky=bulky), qos.recording_latched(offered, bulky=bulky)

    def _create(self, sink: ViewSink, requested: QoSProfile) -> Any:
        tap = RawTap(sink, latency_s=self._latency_s, views=True)
        # rclpy's types allow a callback of one argument only.
        callback: Any = tap
        return self._node.create_subscription(
            message_class(self.type_name),
            self.topic,
            callback,
            requested,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )
