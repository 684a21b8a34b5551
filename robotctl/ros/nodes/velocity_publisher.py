"""The daemon's only publisher of the velocity command."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from threading import Lock

from rclpy.duration import Duration

from robotctl.base.text import short_name
from robotctl.kernel.types import ZERO, Twist
from robotctl.ros import qos
from robotctl.ros.executor import RawTap
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.endpoints import TOOL_NODES, gid_of, node_of, shown_name
from robotctl.ros.message_types import PLAIN, CommandType, OwnTopic, subscribe_raw
from robotctl.ros.session import RECORDER_NODE, Session

NODE_NAME = "velocity_publisher"

MONITORS = (RECORDER_NODE, NODE_NAME)
"""The daemon's nodes that subscribe to the command without moving a robot."""

MAX_NAMED = 8
"""Limit on the other publishers, and on the other command types, that a sentence names."""

LOCK_TIMEOUT_S = 0.02
"""How long `publish_zero` waits for a running publication. A longer one hangs in rclpy."""


def is_monitor(node_name: str) -> bool:
    """Return whether a subscriber of the command is a monitor or a tool, and so moves no robot."""
    return node_name in MONITORS or node_name.startswith(TOOL_NODES)


def command_topic(name: str, command: CommandType = PLAIN) -> OwnTopic:
    """Return the command topic with this name and type."""
    return OwnTopic(name, command.message_class, command.qos)


def publishing_line(twist: Twist) -> str:
    """Return the tutorial's log line for a command."""
    linear, angular = round(twist.linear, 3), round(twist.angular, 3)
    return f"Publishing: linear.x={linear}, angular.z={angular}"


class VelocityPublisher:
    """Node `velocity_publisher`, which sends the velocity commands.

    While its gate is closed, zeros replace the commands. Any thread may call `close_gate` and
    `publish_zero`. One command may still pass after `close_gate`, none after `publish_zero`.
    """

    def __init__(
        self,
        session: Session,
        topic: str,
        command: CommandType = PLAIN,
        is_silent: Callable[[], bool] = lambda: False,
    ) -> None:
        """Send no zeros in `publish_zero` while `is_silent()` is true."""
        self._is_silent = is_silent
        self._node = session.node(NODE_NAME)
        self._log = logging.getLogger(session.logger_name(NODE_NAME))
        self._command = command
        own_topic = command_topic(topic, command)
        self._publisher = own_topic.create_publisher(self._node)
        self._type_name = own_topic.type_name
        self.gid = gid_of(self._publisher)
        """The gid of our commands."""
        self._lock = Lock()
        self._gated = False
        self._zeros = 0
        self._withheld = 0
        self.published = 0
        self.accounted = 0
        """As `published`, but the zeros of `publish_zero` count only after `open_gate`."""

    @property
    def topic(self) -> str:
        """The full name of the command topic."""
        return str(self._publisher.topic_name)

    def monitor(
        self, heard: Callable[[bytes], None], latency_s: float | None
    ) -> Callable[[], None]:
        """Call `heard(gid)` for each command on the topic, from any publisher.

        Commands are collected for `latency_s` [s] or, if that is None, until the returned function
        is called.
        """
        tap = RawTap(lambda data, received, source, sequence, gid: heard(gid), latency_s=latency_s)
        subscribe_raw(self._node, self._command.message_class, self.topic, tap, qos.MONITOR)
        return lambda: tap.poll()

    def name_of(self, gid: bytes) -> str:
        """Return the full name of the node that sends commands with this gid, "" if unknown."""
        return node_of(self._node, self.topic, gid)

    def publish(self, twist: Twist) -> None:
        """Send the velocity command, or zero velocity while the gate is closed."""
        with self._lock:
            if self._gated:
                self._withheld += twist != ZERO
                twist = ZERO
            self._publisher.publish(self._command.encode(twist))
            self.published += 1
            self.accounted += 1
        if self._log.isEnabledFor(logging.DEBUG):
            self._log.debug(publishing_line(twist))

    def publish_zero(self) -> None:
        """Send zero velocity if the gate is closed and `is_silent()` is false.

        Call it in any thread but the loop's.

        Raises:
            TimeoutError: A `publish` in the loop's thread hangs in the middleware.
        """
        if not self._lock.acquire(timeout=LOCK_TIMEOUT_S):
            raise TimeoutError("a publication of the loop hangs in the middleware")
        try:
            if self._gated and not self._is_silent():
                self._publisher.publish(self._command.encode(ZERO))
                self._zeros += 1
                self.published += 1
        finally:
            self._lock.release()

    def is_acknowledged(self) -> bool:
        """Return whether each reliable subscription has received every command."""
        return bool(self._publisher.wait_for_all_acked(Duration()))

    def close_gate(self) -> None:
        """Close the gate: send zero velocity instead of the commands until `open_gate`."""
        self._gated = True

    def open_gate(self) -> tuple[int, int]:
        """Open the gate, so that commands are sent again. Return two counts since the last call.

        They are the zeros that `publish_zero` sent, and the commands that zero has replaced.
        """
        with self._lock:
            self._gated = False
            counts = self._zeros, self._withheld
            self.accounted += self._zeros
            self._zeros = self._withheld = 0
        return counts

    def other_publishers(self) -> tuple[str, ...]:
        """Return the full names of the other nodes that publish on the command topic now."""
        if self.count_publishers() <= 1:
            return ()  # only ours: the usual case, and cheap
        publishers = endpoints.publishers(self._node, self.topic)
        return named_nodes(each for each in publishers if each.gid != self.gid)

    def listeners(self) -> tuple[int, tuple[str, ...], str]:
        """Return (number of subscriptions with our type, types of the others, our type).

        Subscriptions of recorders, monitors and tools are left out.
        """
        types = [
            short_name(each.topic_type)
            for each in endpoints.subscriptions(self._node, self.topic)
            if not is_monitor(each.node_name) and each.node_name != self._node.get_name()
        ]
        others = sorted(set(types) - {self._type_name})
        return types.count(self._type_name), tuple(others[:MAX_NAMED]), self._type_name

    def count_listeners(self) -> int:
        """Return the number of subscriptions to the command topic, recorders included."""
        return int(self._node.count_subscribers(self.topic))

    def count_publishers(self) -> int:
        """Return the number of publishers of the command topic, ours included."""
        return int(self._node.count_publishers(self.topic))


def named_nodes(found: Iterable[endpoints.Endpoint]) -> tuple[str, ...]:
    """Return the sorted full names of the endpoints' nodes, with "N more" after MAX_NAMED."""
    names = sorted(shown_name(each) for each in found)
    named = names[:MAX_NAMED]
    if len(names) > MAX_NAMED:
        named.append(f"{len(names) - MAX_NAMED} more")
    return tuple(named)
