"""What a recording must know of a topic before its first message."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rclpy.qos import QoSProfile

from robotctl.ros.messages import qos
from robotctl.ros.messages.type_definition import definition_of, type_hash_of


@dataclass(frozen=True, slots=True)
class TopicDescription:
    """Full name, type, the type's text and hash, and the QoS that the publishers offer."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


def describe(name: str, type_name: str, offered: Iterable[QoSProfile]) -> TopicDescription:
    """Describe a topic by its full name, its type and the profiles that its publishers offer."""
    return TopicDescription(
        name, type_name, definition_of(type_name), type_hash_of(type_name), qos.to_yaml(offered)
    )
