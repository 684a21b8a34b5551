# mypy: disallow-untyped-calls=False
"""What a replay needs of ROS: publishers for serialized messages, and a look at the graph."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, Self

from ament_index_python.resources import has_resource
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from robotctl.domains import is_deserted
from robotctl.ros.message_types import message_class
from robotctl.ros.recorded_qos import replay_qos

NODE_NAME: Final = "robotctl_replay"
DAEMON_TYPE: Final = "robot_controller/msg/JournalEntry"
"""What every daemon publishes, and nobody else but replays of it."""

SETTLE_S: Final = 3.5
"""Announcements get lost, and are repeated every 3 s: only then everybody is known."""

MATCH_S: Final = 2.0
KNOWN_S: Final = 0.3
"""A publisher knows its subscribers before they know it, and what it sends until then is lost."""

ACKNOWLEDGE_S: Final = 7.0
"""A message that was lost is asked for at the next heartbeat, which may be due only after 3 s."""

BLOCKED_S: Final = 5.0
"""How long a subscriber that reads nothing may hold up a replay at full speed."""

_POLL_S: Final = 0.02
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/(?:msg|srv|action)/[A-Za-z][A-Za-z0-9_]*")


class Unpublishable(Exception):
    """A topic that cannot be published here; the text says why, after the topic's name."""


class ReplaySession:
    """A node in a ROS domain, for the `with` block."""

    def __init__(self, domain_id: int) -> None:
        self._is_alone = is_deserted(domain_id)
        self._joined = time.monotonic()
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id)
        self._node = Node(
            NODE_NAME,
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._publishers: list[Publisher] = []
        self._stopped = threading.Event()

    def __enter__(self) -> Self:
        """The session itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Take the publishers off the graph."""
        self._node.destroy_node()
        self._context.try_shutdown()
        self._context.destroy()

    def stop(self) -> None:
        """Wait for nobody any more; callable from any thread."""
        self._stopped.set()

    def settle(self) -> None:
        """Return when everybody in the domain is known; at once where there is nobody."""
        if not self._is_alone:
            self._stopped.wait(max(self._joined + SETTLE_S - time.monotonic(), 0.0))

    def count_subscribers(self, topic: str) -> int:
        """How many subscribe to the topic, in the whole domain."""
        return int(self._node.count_subscribers(topic))

    def robots_with_daemon(self) -> list[str]:
        """The names of the robots whose daemons are in this domain, whoever runs them."""
        return sorted(
            info.node_namespace.strip("/") or "robot"
            for topic, types in self._node.get_topic_names_and_types()
            if DAEMON_TYPE in types
            for info in self._node.get_publishers_info_by_topic(topic)
            if info.node_name != NODE_NAME
        )

    def check_type(self, type_name: str) -> None:
        """Raise Unpublishable unless the type is installed."""
        _installed_class(type_name)

    def open(
        self, topic: str, type_name: str, offered_qos: str, *, keep_all: bool
    ) -> Callable[[bytes], bool]:
        """Make a publisher; returns what sends a serialized message through it.

        With `keep_all` sending waits for slow subscribers, within limits. Raises Unpublishable.
        """
        try:
            publisher = self._node.create_publisher(
                _installed_class(type_name), topic, replay_qos(offered_qos, keep_all=keep_all)
            )
        except InvalidTopicNameException:
            raise Unpublishable("has a name that ROS does not allow") from None
        except _rclpy.RCLError as error:
            raise Unpublishable(f"cannot be published here: {str(error).splitlines()[0]}") from None
        self._publishers.append(publisher)
        if publisher.qos_profile.history is not HistoryPolicy.KEEP_ALL:
            return _sender(publisher)
        return _patient_sender(publisher, self._stopped)

    def wait_for_matches(self) -> None:
        """Return when the subscribers that are known would get a message, or after 2 s."""
        if not self._is_alone:
            self._stopped.wait(KNOWN_S)
        until = time.monotonic() + MATCH_S
        while time.monotonic() < until and not self._stopped.wait(_POLL_S):
            if all(
                publisher.get_subscription_count() >= self.count_subscribers(publisher.topic_name)
                for publisher in self._publishers
            ):
                return

    def wait_until_received(self) -> None:
        """Return when reliable subscribers have acknowledged everything, or after 7 s."""
        until = time.monotonic() + ACKNOWLEDGE_S
        for publisher in self._publishers:
            if publisher.qos_profile.reliability is ReliabilityPolicy.RELIABLE:
                while not self._stopped.is_set() and time.monotonic() < until:
                    if publisher.wait_for_all_acked(Duration(seconds=0.1)):
                        break


def _installed_class(type_name: str) -> Any:
    match = _TYPE_NAME.fullmatch(type_name)
    # The index is asked first: a file must not choose what Python imports.
    if match is None or not has_resource("rosidl_interfaces", match[1]):
        raise Unpublishable(f"has type {type_name}, which is not installed")
    try:
        return message_class(type_name)
    except ImportError:
        raise Unpublishable(f"has type {type_name}, which is not installed") from None


def _sender(publisher: Publisher) -> Callable[[bytes], bool]:
    publish = publisher.publish

    def send(data: bytes) -> bool:
        try:
            publish(data)
        except _rclpy.RCLError:
            return False
        return True

    return send


def _patient_sender(publisher: Publisher, stopped: threading.Event) -> Callable[[bytes], bool]:
    """Sending that tries again while the queue is full: rcl gives up after 0.1 s."""
    send_once = _sender(publisher)

    def send(data: bytes) -> bool:
        if send_once(data):
            return True
        until = time.monotonic() + BLOCKED_S
        while time.monotonic() < until and not stopped.is_set():
            if send_once(data):
                return True
        return False

    return send
