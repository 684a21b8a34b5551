"""The message types of a velocity command: how each is encoded and decoded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped as TwistStampedMessage
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.kernel.params import CommandQos
from robotctl.kernel.types import Twist
from robotctl.messages.inputs import (
    StampedTwistEncoder,
    decode_twist,
    decode_twist_stamped,
    encode_twist,
)
from robotctl.ros.messages.classes import type_name_of
from robotctl.ros.messages.qos import COMMAND

COMMANDS = {
    CommandQos.RELIABLE: COMMAND,
    CommandQos.BEST_EFFORT: QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
    CommandQos.TRANSIENT_LOCAL: QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
}
"""The profile for each value of `command.qos`; a latched command is at most one tick old."""


@dataclass(frozen=True, slots=True)
class CommandType:
    """A message type of the velocity command, with the functions that encode and decode it.

    `encode` returns a serialized message; `decode` raises `struct.error` if data are missing.
    """

    message_class: Any
    encode: Callable[[Twist], bytes]
    decode: Callable[[bytes], Twist]
    qos: QoSProfile = field(default_factory=lambda: COMMAND)
    """What our publisher offers, and what the simulated robot requests."""

    @property
    def type_name(self) -> str:
        """The type as `package/msg/Name`."""
        return type_name_of(self.message_class)


PLAIN = CommandType(TwistMessage, encode_twist, decode_twist)
"""geometry_msgs/Twist."""


def stamped(frame_id: str) -> CommandType:
    """Return the type geometry_msgs/TwistStamped; `encode` sets `frame_id` and the present time."""
    encoder = StampedTwistEncoder(frame_id)
    return CommandType(
        TwistStampedMessage,
        lambda twist: encoder.encode(twist, time.time_ns()),
        decode_twist_stamped,
    )
