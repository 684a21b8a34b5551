"""The traces of a recording without a journal: odometry, commands and battery from their topics."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from robotctl.cdr.battery import read_battery_level
from robotctl.cdr.known_types import ODOMETRY
from robotctl.cdr.motion import decode_twist, decode_twist_stamped, read_sample
from robotctl.kernel.command_types import TWIST, TWIST_STAMPED
from robotctl.recording import TopicInfo
from robotctl.recording.read.messages import Message
from robotctl.report.traces import Traces

BATTERY: Final = "sensor_msgs/msg/BatteryState"

Taker = Callable[[Traces, float, bytes], None]
"""Takes a message into traces, with its time and its bytes."""


@dataclass(frozen=True, slots=True)
class TopicTraces:
    """What takes the messages of each topic that is drawn, by topic and type."""

    takers: dict[tuple[str, str], Taker]

    def take(self, message: Message, traces: Traces, t_s: float) -> None:
        """Take a message; those of other topics are ignored."""
        taker = self.takers.get((message.topic, message.type_name))
        if taker is not None:
            taker(traces, t_s, message.data)

    @property
    def topics(self) -> list[str]:
        """The topics that are drawn."""
        return [topic for topic, _ in self.takers]


def topic_traces(topics: Sequence[TopicInfo]) -> TopicTraces:
    """Choose the topics to draw: of each kind the one with the most messages."""
    takers: dict[tuple[str, str], Taker] = {}
    kinds: tuple[dict[str, Taker], ...] = (
        {ODOMETRY: _take_odometry},
        {TWIST: _take_command, TWIST_STAMPED: _take_stamped_command},
        {BATTERY: _take_battery},
    )
    for kind in kinds:
        found = [each for each in topics if each.type_name in kind and each.message_count]
        if found:
            chosen = max(found, key=lambda each: each.message_count)
            takers[chosen.name, chosen.type_name] = kind[chosen.type_name]
    return TopicTraces(takers)


def _take_odometry(traces: Traces, t_s: float, data: bytes) -> None:
    sample = read_sample(data)
    traces.driven.add(t_s, sample.x, sample.y)
    traces.linear.add(t_s, sample.linear)
    traces.angular.add(t_s, sample.angular)


def _take_command(traces: Traces, t_s: float, data: bytes) -> None:
    _add_command(traces, t_s, data, stamped=False)


def _take_stamped_command(traces: Traces, t_s: float, data: bytes) -> None:
    _add_command(traces, t_s, data, stamped=True)


def _add_command(traces: Traces, t_s: float, data: bytes, *, stamped: bool) -> None:
    try:
        twist = decode_twist_stamped(data) if stamped else decode_twist(data)
    except struct.error:
        traces.commanded_linear.odd += 1
        return
    traces.commanded_linear.add(t_s, twist.linear)
    traces.commanded_angular.add(t_s, twist.angular)


def _take_battery(traces: Traces, t_s: float, data: bytes) -> None:
    traces.battery.add(t_s, 100.0 * read_battery_level(data))
