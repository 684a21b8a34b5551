"""The battery: how full it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import BatteryState

from robotctl.ros import qos
from robotctl.ros.convert import to_battery_level
from robotctl.ros.session import Session


class BatterySubscriber:
    """Node `battery_subscriber`; takes battery states of any quality of service."""

    def __init__(self, session: Session, topic: str, on_level: Callable[[float], None]) -> None:
        self._on_level = on_level
        node = session.node("battery_subscriber")
        self._subscription = node.create_subscription(
            BatteryState, topic, self._receive, qos.SENSOR
        )

    def _receive(self, message: Any) -> None:
        self._on_level(to_battery_level(message))
