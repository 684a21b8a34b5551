"""The velocity command: the only publisher of it that robotctl has."""

from __future__ import annotations

from threading import Lock

from geometry_msgs.msg import Twist as TwistMessage

from robotctl.kernel.types import ZERO, Twist
from robotctl.ros import qos
from robotctl.ros.cdr import encode_twist
from robotctl.ros.session import Session

LOCK_TIMEOUT_S = 0.02
"""Longer than any publication: whoever holds the lock for longer hangs in the middleware."""

_UNKNOWN_NAME = "_NODE_NAME_UNKNOWN_"
"""What rmw says of a publisher that it discovered before its node."""


class VelocityPublisher:
    """Node `velocity_publisher`; `published` counts the commands that were sent.

    `close_gate` and `publish_zero` may be called from any thread. Once the gate is closed no
    command but zero leaves, also none that was on its way.
    """

    def __init__(self, session: Session, topic: str) -> None:
        self._node = session.node("velocity_publisher")
        self._publisher = self._node.create_publisher(TwistMessage, topic, qos.COMMAND)
        self._zero = encode_twist(ZERO)
        self._lock = Lock()
        self._gated = False
        self.published = 0

    @property
    def topic(self) -> str:
        """The full name of the command topic."""
        return str(self._publisher.topic_name)

    def publish(self, twist: Twist) -> None:
        """Send the command; zero while the gate is closed."""
        with self._lock:
            self._publisher.publish(self._zero if self._gated else encode_twist(twist))
            self.published += 1

    def publish_zero(self) -> None:
        """Send a zero past the loop; raises TimeoutError where a publication hangs."""
        if not self._lock.acquire(timeout=LOCK_TIMEOUT_S):
            raise TimeoutError("a publication of the loop hangs in the middleware")
        try:
            self._publisher.publish(self._zero)
            self.published += 1
        finally:
            self._lock.release()

    def close_gate(self) -> None:
        """Let only zeros through."""
        self._gated = True

    def open_gate(self) -> None:
        """Let every command through again."""
        self._gated = False

    def other_publishers(self) -> tuple[str, ...]:
        """Return the full names of the other nodes that publish the command topic now."""
        own = (self._node.get_name(), self._node.get_namespace())
        others = []
        for info in self._node.get_publishers_info_by_topic(self.topic):
            if (info.node_name, info.node_namespace) == own:
                own = ("", "")  # only once: a second node of our name is not ours
            elif info.node_name == _UNKNOWN_NAME:
                others.append("a node whose name is not known yet")
            else:
                others.append(f"{info.node_namespace.rstrip('/')}/{info.node_name}")
        return tuple(sorted(others))

    def count_publishers(self) -> int:
        """Return how many publishers the command topic has, ours included."""
        return int(self._node.count_publishers(self.topic))
