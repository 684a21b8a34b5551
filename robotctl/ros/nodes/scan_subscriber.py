"""Receives laser scans."""

from __future__ import annotations

import struct
from collections.abc import Callable

from sensor_msgs.msg import LaserScan

from robotctl.cdr.scan import nearest_by_sector
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session


class ScanSubscriber:
    """Receives from publishers of any QoS, as a part of the hidden node."""

    def __init__(
        self, session: Session, topic: str, on_scan: Callable[[tuple[float, ...]], None]
    ) -> None:
        """Call `on_scan(sectors)` for each message, with () for an unreadable one."""
        self._on_scan = on_scan
        node = session.helper()
        self._subscription = node.create_subscription(
            LaserScan,
            topic,
            self._receive,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(self, data: bytes) -> None:
        try:
            sectors = nearest_by_sector(data)
        except struct.error:
            sectors = ()
        self._on_scan(sectors)
