"""Receives laser scans."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import LaserScan

from robotctl.cdr.scan import read_sectors
from robotctl.ros.executor import RawTap
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session


class ScanSubscriber:
    """Receives from publishers of any QoS, as a part of the hidden node."""

    def __init__(
        self, session: Session, topic: str, on_scan: Callable[[tuple[float, ...], str, int], None]
    ) -> None:
        """Call `on_scan(sectors, publisher, sequence)` for each message, () for an unreadable one.

        `publisher` is the gid in hexadecimal digits, `sequence` its own number of the message.
        """
        self._on_scan = on_scan
        node = session.helper()
        tap: Any = RawTap(self._receive, latency_s=0.0)
        self._subscription = node.create_subscription(
            LaserScan,
            topic,
            tap,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        self._on_scan(read_sectors(data), gid.hex(), sequence)
