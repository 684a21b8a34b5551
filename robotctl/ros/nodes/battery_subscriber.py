"""Receives the level of the battery."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState

from robotctl.ros.messages import qos
from robotctl.ros.messages.battery_state import to_battery_level
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session


class BatterySubscriber:
    """Node `battery_subscriber`; receives from publishers of any QoS."""

    def __init__(self, session: Session, topic: str, on_level: Callable[[float], None]) -> None:
        """Call `on_level(level)` for each message, with NaN for an unreadable one."""
        self._on_level = on_level
        node = session.node("battery_subscriber")
        self._subscription = node.create_subscription(
            BatteryState,
            topic,
            self._receive,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(self, data: bytes) -> None:
        try:
            level = to_battery_level(deserialize_message(data, BatteryState))
        except Exception:  # noqa: BLE001 - no received bytes may stop the daemon
            level = nan
        self._on_level(level)
