"""Receives the level of the battery, and identifies the publisher of each message."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import BatteryState

from robotctl.cdr.battery import read_battery_level
from robotctl.ros.executor import RawTap
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session


class BatterySubscriber:
    """Receives from publishers of any QoS, as a part of the hidden node."""

    def __init__(
        self, session: Session, topic: str, on_level: Callable[[float, str, int], None]
    ) -> None:
        """Call `on_level(level, publisher, sequence)` for each message, NaN for an unreadable one.

        `publisher` is the gid in hexadecimal digits, `sequence` its own number of the message.
        """
        self._on_level = on_level
        node = session.helper()
        tap: Any = RawTap(self._receive, latency_s=0.0)
        self._subscription = node.create_subscription(
            BatteryState,
            topic,
            tap,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        self._on_level(read_battery_level(data), gid.hex(), sequence)
