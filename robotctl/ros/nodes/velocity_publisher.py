"""Publishes the velocity command; robotctl has no other publisher of it."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

from geometry_msgs.msg import Twist as TwistMessage

from robotctl.cdr.motion import encode_twist
from robotctl.kernel.types import ZERO, Twist
from robotctl.printable import short_name
from robotctl.ros.executor import RawTap
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.publishers import full_name, gid_of, publisher_names
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.messages.own_topic import OwnTopic
from robotctl.ros.session import RECORDER_NODE, Session

NODE_NAME = "velocity_publisher"

MAX_NAMED = 8
"""Limit on the other publishers, and on the other types, that are named."""

LOCK_TIMEOUT_S = 0.02
"""Longer than any publication takes; a thread that holds the lock longer is stuck in it."""


def command_topic(name: str) -> OwnTopic:
    """Return the declaration of the command topic of this name."""
    return OwnTopic(name, TwistMessage, qos.COMMAND)


class VelocityPublisher:
    """Node `velocity_publisher`; `published` counts the commands that were sent.

    `close_gate` and `publish_zero` may be called from any thread. Once `publish_zero` has sent its
    first zero, only zeros are sent until the gate is opened.
    """

    def __init__(self, session: Session, topic: str) -> None:
        self._node = session.node(NODE_NAME)
        own_topic = command_topic(topic)
        self._publisher = own_topic.create_publisher(self._node)
        self._type_name = own_topic.type_name
        self.gid = gid_of(self._publisher)
        """The gid that our commands carry."""
        self._zero = encode_twist(ZERO)
        self._lock = Lock()
        self._gated = False
        self._zeros = 0
        self._withheld = 0
        self.published = 0

    @property
    def topic(self) -> str:
        """The full name of the command topic."""
        return str(self._publisher.topic_name)

    def monitor(self, heard: Callable[[bytes], None], latency_s: float) -> Callable[[], None]:
        """Call `heard(gid)` for each command on the topic, of any publisher.

        Commands are collected for `latency_s` seconds. Returns a function that takes the collected
        ones at once. The subscription is best effort, so that it receives from publishers of any
        QoS.
        """
        tap = RawTap(lambda data, received, source, sequence, gid: heard(gid), latency_s=latency_s)
        # rclpy's types allow a callback of one argument only.
        callback: Any = tap
        self._node.create_subscription(
            TwistMessage,
            self.topic,
            callback,
            qos.MONITOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )
        return lambda: tap.poll()

    def name_of(self, gid: bytes) -> str:
        """Return the name of the node whose commands carry this gid, "" where unknown."""
        return publisher_names(self._node, self.topic).get(gid, "")

    def publish(self, twist: Twist) -> None:
        """Send the command; zero while the gate is closed."""
        with self._lock:
            if self._gated:
                self._withheld += twist != ZERO
                self._publisher.publish(self._zero)
            else:
                self._publisher.publish(encode_twist(twist))
            self.published += 1

    def publish_zero(self) -> None:
        """Send a zero if the gate is closed; for threads other than the loop's.

        Raises:
            TimeoutError: A publication of the loop hangs.
        """
        if not self._lock.acquire(timeout=LOCK_TIMEOUT_S):
            raise TimeoutError("a publication of the loop hangs in the middleware")
        try:
            if self._gated:
                self._publisher.publish(self._zero)
                self._zeros += 1
                self.published += 1
        finally:
            self._lock.release()

    def close_gate(self) -> None:
        """Send only zeros from now on."""
        self._gated = True

    def open_gate(self) -> tuple[int, int]:
        """Send every command again.

        Returns the number of zeros that `publish_zero` sent, and of commands that were withheld.
        """
        with self._lock:
            self._gated = False
            counts = self._zeros, self._withheld
            self._zeros = self._withheld = 0
        return counts

    def other_publishers(self) -> tuple[str, ...]:
        """Return the full names of the other nodes that publish on the command topic now."""
        publishers = endpoints.publishers(self._node, self.topic)
        others = sorted(short_name(full_name(each)) for each in publishers if each.gid != self.gid)
        named = [name or "a node whose name is not known yet" for name in others[:MAX_NAMED]]
        if len(others) > MAX_NAMED:
            named.append(f"{len(others) - MAX_NAMED} more")
        return tuple(named)

    def listeners(self) -> tuple[int, tuple[str, ...]]:
        """Return how many subscriptions take our commands, and the other types subscribed to.

        Recorders and monitors of daemons are not counted: they drive nothing.
        """
        types = [
            short_name(each.topic_type)
            for each in endpoints.subscriptions(self._node, self.topic)
            if each.node_name not in (RECORDER_NODE, NODE_NAME)
        ]
        others = sorted(set(types) - {self._type_name})
        return types.count(self._type_name), tuple(others[:MAX_NAMED])

    def count_listeners(self) -> int:
        """Return how many subscriptions the command topic has, recorders included."""
        return int(self._node.count_subscribers(self.topic))

    def count_publishers(self) -> int:
        """Return how many publishers the command topic has, ours included."""
        return int(self._node.count_publishers(self.topic))
