"""Receives laser scans."""

from __future__ import annotations

from collections.abc import Callable

from sensor_msgs.msg import LaserScan

from robotctl.cdr.scan import read_sectors
from robotctl.ros.nodes.numbered_subscriber import NumberedSubscriber
from robotctl.ros.session import Session


class ScanSubscriber(NumberedSubscriber[tuple[float, ...]]):
    """Hands on the sectors of each scan, () for an unreadable one."""

    def __init__(
        self, session: Session, topic: str, on_scan: Callable[[tuple[float, ...], str, int], None]
    ) -> None:
        """Call `on_scan(sectors, publisher, sequence)`."""
        super().__init__(session, LaserScan, topic, read_sectors, on_scan)
