"""What a replay needs of ROS: publishers for serialized messages, and a look at the graph."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from robotctl.printable import short_name
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.discovery import Discovery
from robotctl.ros.messages.classes import UnusableType, message_class
from robotctl.ros.messages.type_definition import type_hash_of
from robotctl.ros.playback.membership import NODE_NAME, Membership
from robotctl.ros.playback.recorded_qos import replay_qos
from robotctl.ros.playback.senders import RequestSender, clock_sender, patient_sender, sender

DAEMON_TYPE: Final = "robot_controller/msg/JournalEntry"
"""What every daemon publishes, and nobody else but replays of it."""

SETTLE_S: Final = 3.5
"""Announcements get lost, and are repeated every 3 s: only then everybody is known for sure."""

QUIET_S: Final = 0.3
"""What gets lost of an introduction comes again within so long."""

GLANCE_S: Final = 0.1
"""Enough where a publisher alone does no harm, and nothing is sent before QUIET_S are over."""

MATCH_S: Final = 2.0
KNOWN_S: Final = 0.1
"""A publisher knows its subscribers before they know it, and what it sends until then is lost, or
comes late where it is reliable. It took them 2 ms, and 9 ms beside four busy processes."""

CLOCK_TYPE: Final = "rosgraph_msgs/msg/Clock"

ACKNOWLEDGE_S: Final = 7.0
"""A message that was lost is asked for at the next heartbeat, which may be due only after 3 s."""

_POLL_S: Final = 0.02


class Unpublishable(Exception):
    """A topic that cannot be published here; the text says why, after the topic's name."""


class ReplaySession:
    """The publishers and clients of a member of a domain; once `stopped`, nothing waits any more.

    They are taken off the graph when the membership ends.
    """

    def __init__(self, membership: Membership) -> None:
        self.domain_id = membership.domain_id
        self.stopped = threading.Event()
        self._is_alone = membership.was_certainly_empty
        self._joined = membership.since_s
        self._node = membership.node
        self._discovery = Discovery(membership.node, membership.domain_id)
        self._publishers: list[Publisher] = []
        self._clients: list[Client] = []

    def settle(self, quiet_s: float = QUIET_S) -> None:
        """Return when everybody in the domain is known; at once where there was nobody.

        That is when each has been heard, and for `quiet_s` nothing new has been seen of others.
        """
        if not self._is_alone:
            self._discovery.wait(quiet_s, self._joined + SETTLE_S, self.stopped)

    def count_subscribers(self, topic: str) -> int:
        """How many subscribe to the topic, in the whole domain."""
        return int(self._node.count_subscribers(topic))

    def count_servers(self, service: str) -> int:
        """How many serve the service, in the whole domain."""
        return int(self._node.count_services(service))

    def publishers_of(self, topic: str) -> list[str]:
        """The full names of the other nodes that publish the topic."""
        return sorted(
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in endpoints.publishers(self._node, topic)
            if info.node_name != NODE_NAME
        )

    def robots_with_daemon(self) -> list[str]:
        """The names of the robots whose daemons are in this domain, whoever runs them."""
        return sorted(
            info.node_namespace.strip("/") or "robot"
            for topic, types in endpoints.topics(self._node).items()
            if DAEMON_TYPE in types
            for info in endpoints.publishers(self._node, topic)
            if info.node_name != NODE_NAME
        )

    def check_type(self, type_name: str) -> None:
        """Raise Unpublishable unless the type is installed."""
        _installed_class(type_name)

    def is_same_type(self, type_name: str, type_hash: str) -> bool:
        """Whether the installed type has the recorded hash, or one of both is not known."""
        installed = type_hash_of(type_name)
        return not (installed and type_hash) or installed == type_hash

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
            return sender(publisher)
        return patient_sender(publisher, self.stopped)

    def open_requests(self, service: str, event_type: str) -> Callable[[bytes], bool | None]:
        """Make a client; returns what sends the request of a serialized introspection event.

        Raises Unpublishable.
        """
        event_class = _installed_class(event_type)
        service_class = _installed_class(event_type.removesuffix("_Event"))
        try:
            client = self._node.create_client(service_class, service)
        except InvalidTopicNameException:
            raise Unpublishable("has a name that ROS does not allow") from None
        self._clients.append(client)
        return RequestSender(client, event_class)

    def open_clock(self, topic: str) -> Callable[[int], bool]:
        """Make a publisher of the time; returns what sends one in ns."""
        qos = QoSProfile(depth=10)  # reliable: whoever asks for less gets it, too
        publisher = self._node.create_publisher(_installed_class(CLOCK_TYPE), topic, qos)
        return clock_sender(publisher)

    def count_matched(self) -> int:
        """How many subscribers have matched, over all topics."""
        return sum(publisher.get_subscription_count() for publisher in self._publishers)

    def wait_for_subscribers(self, expected: int, tell: Callable[[int], object]) -> None:
        """Return when so many subscribers have matched, over all topics; `tell` hears how many."""
        matched = -1
        while not self.stopped.wait(_POLL_S):
            if self.count_matched() != matched:
                matched = self.count_matched()
                tell(matched)
            if matched >= expected:
                self._is_alone = False
                return

    def wait_for_matches(self) -> None:
        """Return when the subscribers and servers that are known have matched and know it.

        Waits for 2 s at most, and not at all where nobody is there.
        """
        if self._is_alone:
            return
        until = time.monotonic() + MATCH_S
        matched, since = -1, time.monotonic()
        while time.monotonic() < until and not self.stopped.wait(_POLL_S):
            if self.count_matched() != matched:
                matched, since = self.count_matched(), time.monotonic()
            if time.monotonic() - since > KNOWN_S and self._all_matched():
                return

    def wait_until_received(self) -> None:
        """Return when reliable subscribers have acknowledged everything, or after 7 s."""
        until = time.monotonic() + ACKNOWLEDGE_S
        for publisher in self._publishers:
            if publisher.qos_profile.reliability is ReliabilityPolicy.RELIABLE:
                while not self.stopped.is_set() and time.monotonic() < until:
                    if publisher.wait_for_all_acked(Duration(seconds=0.1)):
                        break

    def _all_matched(self) -> bool:
        return all(
            publisher.get_subscription_count() >= self.count_subscribers(publisher.topic_name)
            for publisher in self._publishers
        ) and all(
            client.service_is_ready() or not self.count_servers(client.service_name)
            for client in self._clients
        )


def _installed_class(type_name: str) -> Any:
    try:
        return message_class(type_name)
    except UnusableType as error:
        raise Unpublishable(f"has type {short_name(type_name)}, which {error}") from None
