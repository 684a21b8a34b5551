"""Odometry: where the robot says it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nav_msgs.msg import Odometry as OdometryMessage

from robotctl.kernel.types import Odometry
from robotctl.ros import qos
from robotctl.ros.cdr import decode_odometry
from robotctl.ros.raw import RawTap
from robotctl.ros.session import Session


class OdomSubscriber:
    """Node `odom_subscriber`; takes odometry of any quality of service."""

    def __init__(
        self, session: Session, topic: str, on_odometry: Callable[[Odometry], None]
    ) -> None:
        self._node = session.node("odom_subscriber")
        self._on_odometry = on_odometry
        # Raw for the sake of speed, but never late: the kernel decides on what it hears.
        tap: Any = RawTap(self._receive, latency_s=0.0)
        self._subscription = self._node.create_subscription(
            OdometryMessage, topic, tap, qos.SENSOR, raw=True
        )

    @property
    def topic(self) -> str:
        """The full name of the odometry topic."""
        return str(self._subscription.topic_name)

    def count_publishers(self) -> int:
        """Return how many nodes publish odometry now."""
        return int(self._node.count_publishers(self.topic))

    def _receive(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        self._on_odometry(decode_odometry(data))
