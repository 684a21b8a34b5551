"""The classes of message types, by name, and the types of a velocity command."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from robotctl.kernel.constants import TWIST, TWIST_STAMPED
from robotctl.kernel.params import CommandQos
from robotctl.kernel.types import Twist
from robotctl.messages.inputs import (
    StampedTwistEncoder,
    decode_twist,
    decode_twist_stamped,
    encode_twist,
)
from robotctl.messages.installed import UnusableType, installed_name
from robotctl.ros.executor import RawTap
from robotctl.ros.qos import COMMAND


def type_name_of(message_class: Any) -> str:
    """Return the name of a generated class as `package/kind/Name`."""
    package, kind, *_ = message_class.__module__.split(".")
    return f"{package}/{kind}/{message_class.__name__}"


@lru_cache(maxsize=1024)
def message_class(type_name: str) -> Any:
    """Return the class of a message, service or action type, such as `pkg/srv/T_Event`.

    Raises:
        UnusableType: The name is invalid, or the type is not installed or cannot be loaded.
    """
    # Other processes and files must not choose what Python imports: only installed packages.
    name = installed_name(type_name)
    try:
        module = import_module(f"{name.package}.{name.kind}")
        # `T_Event` is defined in the module of `T`; the package does not always export it.
        module = import_module(getattr(module, name.interface).__module__)
        return getattr(module, name.short)
    except BaseException as error:
        # Only the main thread gets the KeyboardInterrupt of a Ctrl-C.
        if (
            isinstance(error, KeyboardInterrupt)
            and threading.current_thread() is threading.main_thread()
        ):
            raise
        raise UnusableType(f"cannot be loaded ({type(error).__name__}: {error})") from error


# Without rclpy's default event handlers, each of which takes a file descriptor.
NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


def subscribe_raw(
    node: Node, message_class: Any, topic: str, tap: RawTap, wanted: QoSProfile
) -> Subscription:
    """Subscribe to a topic's serialized messages, and pass each with its origin to `tap`."""
    callback: Any = tap  # rclpy's types allow a callback of one argument only
    return node.create_subscription(
        message_class, topic, callback, wanted, event_callbacks=NO_SUBSCRIPTION_EVENTS, raw=True
    )


@dataclass(frozen=True, slots=True)
class OwnTopic:
    """A topic of robotctl with its offered QoS. A relative `name` is in the robot's namespace."""

    name: str
    message_class: Any
    qos: QoSProfile

    @property
    def type_name(self) -> str:
        """The type as `package/msg/Name`."""
        return type_name_of(self.message_class)

    def create_publisher(
        self, node: Node, events: PublisherEventCallbacks = NO_PUBLISHER_EVENTS
    ) -> Publisher:
        """Create a publisher of the topic on `node`."""
        return node.create_publisher(
            self.message_class, self.name, self.qos, event_callbacks=events
        )


COMMANDS = {
    CommandQos.RELIABLE: COMMAND,
    CommandQos.BEST_EFFORT: QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
    CommandQos.TRANSIENT_LOCAL: QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
}
"""Value of `command.qos` -> profile. With depth 1, a waiting command is at most one tick old."""


@dataclass(frozen=True, slots=True)
class CommandType:
    """A message type of the velocity command. `decode` raises `struct.error` for missing data."""

    type_name: str
    """The type as `package/msg/Name`."""
    encode: Callable[[Twist], bytes]
    decode: Callable[[bytes], Twist]
    qos: QoSProfile = field(default_factory=lambda: COMMAND)
    """The QoS of our publisher, and of the simulated robot's subscription."""

    @property
    def message_class(self) -> Any:
        """The class of the messages."""
        return message_class(self.type_name)


PLAIN = CommandType(TWIST, encode_twist, decode_twist)
"""The command type geometry_msgs/Twist."""


def stamped(frame_id: str) -> CommandType:
    """Return the command type TwistStamped, with this `frame_id`, stamped at encoding."""
    encoder = StampedTwistEncoder(frame_id)
    return CommandType(
        TWIST_STAMPED,
        lambda twist: encoder.encode(twist, time.time_ns()),
        decode_twist_stamped,
    )
