"""What a recording must know of a topic before its first message."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TopicDescription:
    """Name, type, the type's text and hash, and the QoS that its publishers offer."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str
