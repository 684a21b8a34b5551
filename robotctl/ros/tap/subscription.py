"""The subscription of one tapped topic.

A transient-local subscription gets latched messages, but nothing of volatile publishers; a volatile
one gets new messages of all publishers, but no latched ones (DDS 1.4, 2.2.3.4). So a topic with
both kinds of publisher takes two subscriptions. A new one gets the latched messages again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from robotctl.messages.installed import installed_type
from robotctl.ros.executor import RawTap, SerializedData, ViewSink
from robotctl.ros.messages import qos
from robotctl.ros.messages.classes import NO_SUBSCRIPTION_EVENTS, message_class

Span = tuple[int, int]
"""The first and the last sequence number that one subscription delivered from a publisher."""

NOTHING: Span = (1, 0)
MAX_PUBLISHERS = 1024
"""Limit on the publishers of a topic that are remembered; the latched messages of a publisher that
was forgotten may be recorded twice."""

T = TypeVar("T")


class LatchedMerge:
    """Passes each message to the sink only once, even if two subscriptions deliver it.

    It relies on each subscription to deliver the messages of one publisher in order.
    """

    def __init__(self, sink: ViewSink) -> None:
        self._sink = sink
        self._live: dict[bytes, Span] = {}
        self._latched: dict[bytes, Span] = {}
        self._known: dict[bytes, int] = {}
        """Publisher's gid -> the last sequence number that earlier subscriptions delivered."""

    def live(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Accept a message of the volatile subscription: a new message of any publisher."""
        first, _ = self._live.get(gid, (sequence, sequence))
        _keep(self._live, gid, (first, sequence))
        first_latched, last_latched = self._latched.get(gid, NOTHING)
        if not first_latched <= sequence <= last_latched:
            self._sink(data, received_ns, source_ns, sequence, gid)

    def latched(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Accept a message of the transient-local subscription: a latched or a new message."""
        _, last = self._latched.get(gid, NOTHING)
        if 0 < sequence <= max(last, self._known.get(gid, 0)):
            return  # a publisher that is discovered again after a loss repeats it as well
        if gid not in self._live or sequence < self._live[gid][0]:
            first, _ = self._latched.get(gid, (sequence, sequence))
            _keep(self._latched, gid, (first, sequence))
            self._sink(data, received_ns, source_ns, sequence, gid)

    def restart(self) -> None:
        """Prepare for new subscriptions, which deliver the same latched messages again."""
        for spans in (self._live, self._latched):
            for gid, (_, last) in spans.items():
                _keep(self._known, gid, max(last, self._known.get(gid, 0)))
            spans.clear()


def _keep(known: dict[bytes, T], gid: bytes, what: T) -> None:
    """Remember a value of a publisher; at the limit, forget the oldest publisher."""
    if gid not in known and len(known) >= MAX_PUBLISHERS:
        del known[next(iter(known))]
    known[gid] = what


LATENCY_S = 0.05
"""How long messages are collected, since it costs less to handle them together. The middleware sets
their time stamps, so the recording does not show the delay."""

Requests = tuple[QoSProfile, QoSProfile | None]
"""The QoS of the subscription, and that of the second one for latched messages, if needed."""


class TappedSubscription:
    """Passes the messages of one topic to its sink, until `close`."""

    def __init__(
        self,
        node: Node,
        topic: str,
        type_name: str,
        sink: ViewSink,
        offered: Sequence[QoSProfile],
        latency_s: float = LATENCY_S,
    ) -> None:
        """Subscribe to publishers that offer these profiles; collect messages for `latency_s`."""
        self.topic = topic
        self.type_name = type_name
        self.publishers = 0
        """The number of publishers at the last look at the graph; `Tap` sets it."""

        self.abandoned_since: float | None = None
        """When the topic lost its last publisher [steady s]; None while it has one."""

        self._node = node
        self._latency_s = latency_s
        self._sink = sink
        self._merge = LatchedMerge(sink)
        self._subscriptions: list[Any] = []
        self._requests = self._requests_for(offered)
        self._subscribe(self._requests)

    @property
    def is_latched(self) -> bool:
        """Whether a new subscription to the topic would get latched messages."""
        requested, latched = self._requests
        return latched is not None or requested.durability is DurabilityPolicy.TRANSIENT_LOCAL

    def adapt(self, offered: Sequence[QoSProfile]) -> None:
        """Subscribe again if `offered`, the publishers' present profiles, requires another QoS.

        Messages that are sent before the new subscription has matched are lost, and count as lost.

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
        bulky = installed_type(self.type_name).holds_bytes
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
