"""The description and the message counts of a topic."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from itertools import islice
from typing import Final, NamedTuple, cast

from robotctl.recording.format.names import LEDGER_RECORD


@dataclass(slots=True)
class MessageCounts:
    """Counts of messages, in which received = written + queued + dropped."""

    received: int = 0
    written: int = 0
    queued: int = 0
    dropped: int = 0
    lost: int = 0
    """Missing between two received messages: gaps in a publisher's sequence numbers."""

    unseen: int = 0
    """Sent by a publisher before its first received message."""

    not_repeated: int = 0
    """Latched messages missing in a later file, for lack of memory or file space."""

    throttled: int = 0
    """Not recorded and not in `received`: above the topic's rate, or the disk is almost full."""


COUNTERS: Final = tuple(field.name for field in fields(MessageCounts))


LATCHED_QOS = "durability: transient_local"
"""A text in the offered QoS of each topic with a latched publisher."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic as a file describes it.

    `definition` is ros2msg text or "". `offered_qos` is rosbag2's YAML list, one entry per
    publisher.
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


class TopicStats(NamedTuple):
    """The MessageCounts of one topic. `bytes` counts the data of received messages."""

    # In the order of COUNTERS. Creating a data class would take 1.3 times as long.
    received: int = 0
    written: int = 0
    queued: int = 0
    dropped: int = 0
    lost: int = 0
    unseen: int = 0
    not_repeated: int = 0
    throttled: int = 0
    name: str = ""
    type_name: str = ""
    bytes: int = 0


def total(counts: Iterable[TopicStats]) -> dict[str, int]:
    """Return the sum of each counter (`received`, `written`, ...) over all topics, by name."""
    columns = cast(Iterable[tuple[int, ...]], islice(zip(*counts, strict=True), len(COUNTERS)))
    return dict(zip(COUNTERS, map(sum, columns), strict=False)) or dict.fromkeys(COUNTERS, 0)


def by_topic(channels: Iterable[TopicStats]) -> list[TopicStats]:
    """Return the total counts of each topic and type, in the order of first appearance."""
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


_COUNTS = (*COUNTERS, "bytes")


def ledger_values(topics: Iterable[TopicStats]) -> dict[str, str]:
    """Return the loss ledger, which has counts in JSON by topic name."""
    ledger: dict[str, str] = {}
    for stats in by_topic(topics):
        # A topic has a second type if a node publishes one.
        name = f"{stats.name} ({stats.type_name})" if stats.name in ledger else stats.name
        ledger[name] = json.dumps({count: getattr(stats, count) for count in _COUNTS})
    return ledger


def read_ledger(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, int]]:
    """Return the counts by topic of the loss ledger in `metadata`, {} without a ledger."""
    ledger = {}
    for topic, text in metadata.get(LEDGER_RECORD, {}).items():
        try:
            counts = json.loads(text)
            ledger[topic] = {count: int(counts[count]) for count in _COUNTS if count in counts}
        except (ValueError, TypeError, OverflowError, RecursionError):  # not written by robotctl
            continue
    return ledger
