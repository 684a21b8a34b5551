"""Receives the level of the battery."""

from __future__ import annotations

from collections.abc import Callable

from sensor_msgs.msg import BatteryState

from robotctl.cdr.battery import read_battery_level
from robotctl.ros.nodes.numbered_subscriber import NumberedSubscriber
from robotctl.ros.session import Session


class BatterySubscriber(NumberedSubscriber[float]):
    """Hands on the level of each message, NaN for an unreadable one."""

    def __init__(
        self, session: Session, topic: str, on_level: Callable[[float, str, int], None]
    ) -> None:
        """Call `on_level(level, publisher, sequence)`."""
        super().__init__(session, BatteryState, topic, read_battery_level, on_level)
