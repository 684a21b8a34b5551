"""What a file says about a topic, and the counts of one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from robotctl.recording.format.message_counts import MessageCounts, total

LATCHED_QOS = "durability: transient_local"
"""In the offered QoS of a topic with a latched publisher."""


@dataclass(frozen=True, slots=True)
class Topic:
    """What a file says about a topic.

    `definition` is the ros2msg text, "" if unknown. `offered_qos` is the YAML list that rosbag2
    writes, one entry per publisher.
    """

    name: str
    type_name: str
    definition: str = ""
    type_hash: str = ""
    offered_qos: str = ""
    encoding: str = "cdr"

    @property
    def latched(self) -> bool:
        """Whether a publisher offers its last message to late subscribers."""
        return LATCHED_QOS in self.offered_qos


@dataclass(slots=True)
class TopicStats(MessageCounts):
    """The counts of one topic; `bytes` counts the data of received messages."""

    name: str = ""
    type_name: str = ""
    bytes: int = 0


def by_topic(channels: Iterable[TopicStats]) -> list[TopicStats]:
    """Return one entry for each topic and type, in their order, as the sum of its channels."""
    groups: dict[tuple[str, str], list[TopicStats]] = {}
    for channel in channels:
        groups.setdefault((channel.name, channel.type_name), []).append(channel)
    return [
        group[0]
        if len(group) == 1
        else TopicStats(
            name=name, type_name=type_name, bytes=sum(each.bytes for each in group), **total(group)
        )
        for (name, type_name), group in groups.items()
    ]
