"""Publishes recorded messages on ROS again."""

from __future__ import annotations

import re
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any, Final

import yaml
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from robotctl.base.text import short_name
from robotctl.kernel.constants import NS_PER_S
from robotctl.messages.cdr import ENCAPSULATION, JOURNAL_ENTRY
from robotctl.messages.installed import UnusableType, installed_name, installed_type
from robotctl.ros.context import Membership
from robotctl.ros.graph import endpoints
from robotctl.ros.message_types import message_class

BLOCKED_S: Final = 5.0
"""How long a replay at full speed waits for a subscriber that does not acknowledge."""

ACKNOWLEDGED_POLL_S: Final = 0.001
"""The time between two checks for acknowledgements, which come after about 5 ms."""

MAX_OPEN_REQUESTS: Final = 10_000
"""Limit on the remembered requests, of which a second event may follow."""

_CLOCK = struct.Struct("<4siI")
"""rosgraph_msgs/Clock, as encapsulation, seconds and nanoseconds."""


def sender(publisher: Publisher) -> Callable[[bytes], bool]:
    """Return a function that publishes a message and returns whether the middleware accepted it."""
    publish = publisher.publish

    def send(data: bytes) -> bool:
        try:
            publish(data)
        except _rclpy.RCLError:
            return False
        return True

    return send


class PatientSender:
    """Publishes messages no faster than reliable subscribers acknowledge them."""

    def __init__(self, publisher: Publisher, in_flight: int, stopped: threading.Event) -> None:
        """Wait after `in_flight` messages, or fewer for a short queue. `stopped` ends a wait."""
        self.topic = str(publisher.topic_name)
        self.given_up = 0
        """The number of waits that ended before all messages were acknowledged."""

        self._send = sender(publisher)
        self._publisher = publisher
        self._stopped = stopped
        self._in_flight = min(in_flight, int(publisher.qos_profile.depth))
        self._unacknowledged = 0

    # Not with a KEEP_ALL queue: with Fast DDS 2.14, one lost message could then block a subscriber
    # forever. Newer messages fill its queue, and then it refuses each retransmission of the lost
    # message (`DataReaderHistory::received_change_keep_last`).
    def __call__(self, data: bytes) -> bool:
        """Publish a message, and return whether the middleware accepted it."""
        if self._unacknowledged >= self._in_flight:
            self.given_up += not self._is_acknowledged()
            self._unacknowledged = 0
        self._unacknowledged += 1
        return self._send(data)

    def _is_acknowledged(self) -> bool:
        until_s = time.monotonic() + BLOCKED_S
        # Polled, because a wait in rclpy would hold the GIL.
        while not self._publisher.wait_for_all_acked(Duration()):
            if self._stopped.wait(ACKNOWLEDGED_POLL_S) or time.monotonic() > until_s:
                return False
        return True


class RequestSender:
    """Reads a request from a serialized introspection event, and sends it to the service."""

    def __init__(self, client: Client, event_type: Any) -> None:
        self._client = client
        self._event_type = event_type
        self._balances: OrderedDict[tuple[int, str], int] = OrderedDict()
        """Request -> its number of client events minus its number of server events."""

    def __call__(self, data: bytes) -> bool | None:
        """Send the request of a serialized event, and return whether that worked.

        Return None if the event has no request, or if its request was sent already.
        """
        try:
            event = deserialize_message(data, self._event_type)
        except _rclpy.RCLError:
            return False
        if not event.request or self._was_sent(event):
            return None
        if not self._client.service_is_ready():
            return False
        with self._client.handle:
            self._client.handle.send_request(event.request[0])
        return True

    def _was_sent(self, event: Any) -> bool:
        # Client and server each record an event of a request: send it for the first of them.
        info = event.info
        key = (info.sequence_number, repr(event.request[0]))  # bytes differ in their padding
        balance = self._balances.pop(key, 0)
        change = 1 if info.event_type == info.REQUEST_SENT else -1
        if balance + change:
            self._balances[key] = balance + change
        if len(self._balances) > MAX_OPEN_REQUESTS:
            self._balances.popitem(last=False)
        return balance * change < 0


_WORD: Final = re.compile(r"(?<=.)(?=[A-Z][a-z])|(?<=[a-z0-9])(?=[A-Z])")
"""The places in a type name at which rosidl puts an underscore, for the name of the module."""

_OF_RCLPY: Final = (
    *("type_support", "create_ros_message", "destroy_ros_message"),
    *("convert_from_py", "convert_to_py"),
)
"""The attributes of a type's metaclass that rclpy reads, as `_TYPE_SUPPORT` etc."""


@lru_cache(maxsize=1024)
def serialized_type(type_name: str) -> Any:
    """Return a class for `pkg/msg/T` without fields, for publishing serialized messages only.

    For a type of a service or action, such as `pkg/srv/T_Event`, return the whole class.

    Raises:
        UnusableType: The type is not installed, or loading it failed.
    """
    name = installed_name(type_name)
    if name.kind != "msg":
        return message_class(type_name)
    # Without importing the message package and numpy, which takes 80 ms of CPU for Odometry.
    suffix = f"msg__msg__{_WORD.sub('_', name.short).lower()}"
    try:
        module = import_module(f"{name.package}.{name.package}_s__rosidl_typesupport_c")
        found = {f"_{each.upper()}": getattr(module, f"{each}_{suffix}") for each in _OF_RCLPY}
    except Exception as error:
        raise UnusableType(f"cannot be loaded ({type(error).__name__}: {error})") from error
    return type(f"Metaclass_{name.short}", (type,), found)(name.short, (), {})


MAX_TEXT: Final = 1 << 20
MAX_DEPTH: Final = 10_000
VOLATILE_DEPTH: Final = 1000
"""The least depth of a volatile topic's queue. A short one loses bursts, a long one is harmless."""

_INFINITE_SEC: Final = 2_147_483_647
"""An infinite time [s] in recordings from before Jazzy. Later ones have a larger number."""

_RELIABILITY = {"1": ReliabilityPolicy.RELIABLE, "2": ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"1": DurabilityPolicy.TRANSIENT_LOCAL, "2": DurabilityPolicy.VOLATILE}
_RELIABILITY |= {policy.short_key: policy for policy in _RELIABILITY.values()}
_DURABILITY |= {policy.short_key: policy for policy in _DURABILITY.values()}
"""Policies by name, and by number in rmw/types.h (rosbag2 before metadata version 9)."""


def replay_qos(offered: str, *, most: int = MAX_DEPTH) -> QoSProfile:
    """Return a QoS profile that matches every subscriber which the recorded publishers match.

    `offered` is the text `offered_qos_profiles` of a recording; if it cannot be read, the profile
    is reliable and volatile. `most` limits the depth of a volatile profile.
    """
    profiles = _profiles(offered)
    reliabilities = [_RELIABILITY.get(str(each.get("reliability"))) for each in profiles]
    durabilities = [_DURABILITY.get(str(each.get("durability"))) for each in profiles]
    reliable = any(each is not ReliabilityPolicy.BEST_EFFORT for each in reliabilities)
    latched = DurabilityPolicy.TRANSIENT_LOCAL in durabilities
    reliable = reliable or not profiles
    # DDS does not announce depths, so a recording may have 0: then assume 1, the most common one.
    depth = sum(max(_depth(each), 1) for each in profiles)
    if not latched:
        depth = min(max(depth, VOLATILE_DEPTH), most)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=min(depth, MAX_DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        deadline=_common(profiles, "deadline"),
        lifespan=_common(profiles, "lifespan"),
    )


def latched_depth(offered: str) -> int:
    """Return the number of latched messages for a late subscriber, 0 if the topic is volatile."""
    qos = replay_qos(offered)
    return int(qos.depth) if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL else 0


def _profiles(offered: str) -> Sequence[Mapping[str, Any]]:
    if len(offered) > MAX_TEXT:
        return []
    try:
        found = yaml.safe_load(offered)
    except (yaml.YAMLError, ValueError, RecursionError):
        return []
    return [each for each in found if isinstance(each, dict)] if isinstance(found, list) else []


def _depth(profile: Mapping[str, Any]) -> int:
    depth = profile.get("depth")
    return min(depth, MAX_DEPTH) if isinstance(depth, int) else 0


def _common(profiles: Sequence[Mapping[str, Any]], policy: str) -> Duration:
    """Return the duration of a policy if it is equal in all profiles, else 0 (unspecified)."""
    spans = {_span_ns(each.get(policy)) for each in profiles}
    return Duration(nanoseconds=spans.pop() if len(spans) == 1 else 0)


def _span_ns(value: object) -> int:
    sec, nsec = (value.get("sec"), value.get("nsec")) if isinstance(value, dict) else (0, 0)
    if not isinstance(sec, int) or not isinstance(nsec, int):
        return 0
    is_finite = 0 <= sec < _INFINITE_SEC and 0 <= nsec < NS_PER_S
    return sec * NS_PER_S + nsec if is_finite else 0


SETTLE_S: Final = 3.5
"""Limit on the time of discovery, as a lost announcement is repeated after 3 s."""

QUIET_S: Final = 0.03
"""How long the graph must not change, as a starting process adds its endpoints one by one."""

MATCH_S: Final = 2.0
# They take 8 ms, or 0.2 s if a message gets lost. A process that was killed never acknowledges.
KNOWN_S: Final = 0.5
"""How long to wait until other processes acknowledge that they know our publishers."""

ACKNOWLEDGE_S: Final = 7.0
"""How long to wait at the end for acknowledgements. A lost message takes 3 s or more."""

REQUEST_S: Final = 0.2  # the wait at the end: rclpy does not report that a request has arrived

# Few messages get lost while they fit into the shared memory of Fast DDS (512 kB).
IN_FLIGHT: Final = 250
"""The number of unacknowledged messages at which a replay at full speed waits."""

IN_FLIGHT_BULKY: Final = 5
"""As IN_FLIGHT, for images, point clouds and the like."""

_POLL_S: Final = 0.02
_MATCHED_POLL_S: Final = 0.002


class Unpublishable(Exception):
    """A topic cannot be published here. The text follows "the topic NAME "."""


class ReplaySession:
    """Creates the publishers and clients of a replay.

    They belong to the node of `membership`, this process's stay in a ROS domain, and exist until
    it ends. Setting the event `stopped` ends every wait.
    """

    def __init__(self, membership: Membership) -> None:
        self.domain_id = membership.domain_id
        self.stopped = threading.Event()
        self._is_alone = membership.was_certainly_empty
        self._joined = membership.since_s
        self._node = membership.node
        self._discovery = membership.discovery
        self._publishers: list[Publisher] = []
        self._patient: list[PatientSender] = []
        self._clients: list[Client] = []

    def settle(self, quiet_s: float = QUIET_S) -> None:
        """Wait until every process is discovered and nothing changed for `quiet_s` seconds.

        The wait ends at the latest SETTLE_S after this process joined the domain.
        """
        if not self._is_alone:
            self._discovery.wait(quiet_s, self._joined + SETTLE_S, self.stopped)

    def publishers_of(self, topic: str) -> list[str]:
        """Return the full names of the other nodes that publish on the topic."""
        return sorted(
            endpoints.shown_name(info)
            for info in endpoints.publishers(self._node, topic)
            if info.node_name != self._node.get_name()
        )

    def robots_with_daemon(self) -> list[str]:
        """Return the names of the robots that have a daemon, of any user, in this domain."""
        return sorted(
            (
                topic.rsplit("/", 2)[0]  # of /r2/robotctl/journal
                if info.node_name == endpoints.UNKNOWN_NODE
                else info.node_namespace
            ).strip("/")
            or "robot"
            for topic, types in endpoints.topics(self._node).items()
            if JOURNAL_ENTRY in types
            for info in endpoints.publishers(self._node, topic)
            if info.node_name != self._node.get_name()
        )

    def check_type(self, type_name: str) -> None:
        """Raise `Unpublishable` if the message type is not installed or cannot be loaded."""
        _installed(serialized_type, type_name)

    def is_same_type(self, type_name: str, type_hash: str) -> bool:
        """Return whether the installed type has the hash `type_hash`. True if a hash is unknown."""
        installed = installed_type(type_name).type_hash
        return not (installed and type_hash) or installed == type_hash

    def open(
        self, topic: str, type_name: str, offered_qos: str, *, patient: bool
    ) -> Callable[[bytes], bool]:
        """Create a publisher, and return a function that sends serialized messages with it.

        The function returns whether the middleware accepted the message. With `patient`, it waits
        for slow reliable subscribers, at most BLOCKED_S per call.

        Raises:
            Unpublishable: ROS does not allow the name, or the type cannot be published here.
        """
        message_type = _installed(serialized_type, type_name)
        bulky = installed_type(type_name).holds_bytes
        most = (IN_FLIGHT_BULKY if bulky else IN_FLIGHT) if patient else MAX_DEPTH
        try:
            publisher = self._node.create_publisher(
                message_type, topic, replay_qos(offered_qos, most=most)
            )
        except InvalidTopicNameException:
            raise Unpublishable("has a name that ROS does not allow") from None
        except _rclpy.RCLError as error:
            raise Unpublishable(f"cannot be published here: {str(error).splitlines()[0]}") from None
        self._publishers.append(publisher)
        if not patient or publisher.qos_profile.reliability is not ReliabilityPolicy.RELIABLE:
            return sender(publisher)
        self._patient.append(PatientSender(publisher, most, self.stopped))
        return self._patient[-1]

    def open_requests(self, service: str, event_type: str) -> Callable[[bytes], bool | None]:
        """Create a client, and return a `RequestSender` for it.

        Raises:
            Unpublishable: ROS does not allow the name, or the type cannot be loaded.
        """
        event_class = _installed(message_class, event_type)
        service_class = _installed(message_class, event_type.removesuffix("_Event"))
        try:
            client = self._node.create_client(service_class, service)
        except InvalidTopicNameException:
            raise Unpublishable("has a name that ROS does not allow") from None
        self._clients.append(client)
        return RequestSender(client, event_class)

    def open_clock(self, topic: str) -> Callable[[int], bool]:
        """Create a publisher of the ROS clock. Return a function that publishes a time [ns]."""
        qos = QoSProfile(depth=10)  # reliable: matches best-effort subscriptions too
        clock = serialized_type("rosgraph_msgs/msg/Clock")
        send = sender(self._node.create_publisher(clock, topic, qos))
        return lambda time_ns: send(_CLOCK.pack(ENCAPSULATION, *divmod(time_ns, NS_PER_S)))

    def wait_for_subscribers(self, expected: int, tell: Callable[[int], object]) -> None:
        """Wait until `expected` subscriptions have matched, and call `tell` with each new count."""
        matched = -1
        while not self.stopped.wait(_POLL_S):
            now = sum(publisher.get_subscription_count() for publisher in self._publishers)
            if now != matched:
                matched = now
                tell(matched)
            if matched >= expected:
                self._is_alone = False
                return

    def wait_for_matches(self) -> None:
        """Wait until our publishers and clients are matched, and other processes know them.

        Messages sent before are lost, or late if the publisher is reliable. The wait takes at most
        MATCH_S + KNOWN_S.
        """
        if self._is_alone:
            return
        until_s = time.monotonic() + MATCH_S
        while not self._all_matched() and time.monotonic() < until_s:
            if self.stopped.wait(_MATCHED_POLL_S):
                return
        self._discovery.make_known(time.monotonic() + KNOWN_S, self.stopped)

    def wait_until_received(self) -> None:
        """Wait until reliable subscriptions acknowledge all messages, at most ACKNOWLEDGE_S."""
        self.stopped.wait(REQUEST_S if self._clients else 0.0)
        until = time.monotonic() + ACKNOWLEDGE_S
        for publisher in self._publishers:
            if publisher.qos_profile.reliability is ReliabilityPolicy.RELIABLE:
                while not self.stopped.is_set() and time.monotonic() < until:
                    if publisher.wait_for_all_acked(Duration(seconds=0.1)):
                        break

    def given_up(self) -> list[str]:
        """Return the topics on which a subscriber has failed to acknowledge messages in time."""
        return sorted(each.topic for each in self._patient if each.given_up)

    def _all_matched(self) -> bool:
        return all(
            publisher.get_subscription_count() >= self._node.count_subscribers(publisher.topic_name)
            for publisher in self._publishers
        ) and all(
            client.service_is_ready() or not self._node.count_services(client.service_name)
            for client in self._clients
        )


def _installed(load: Callable[[str], Any], type_name: str) -> Any:
    try:
        return load(type_name)
    except UnusableType as error:
        raise Unpublishable(f"has type {short_name(type_name)}, which {error}") from None
