"""Scans are received from publishers of any QoS, with the number that the publisher gave them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from math import inf
from typing import Any

from robotctl.ros.messages import qos
from robotctl.ros.nodes.input_subscribers import ScanSubscriber
from robotctl.ros.session import Session

Until = Callable[[Callable[[], object]], Awaitable[None]]


async def test_a_scan_is_told_by_sectors_with_its_publisher_and_number(
    session: Session, node: Any, until: Until
) -> None:
    from sensor_msgs.msg import LaserScan

    told: list[tuple[tuple[float, ...], str, int]] = []
    ScanSubscriber(session, "scan", lambda *scan: told.append(scan))
    publisher = node.create_publisher(LaserScan, "/r2/scan", qos.SENSOR)
    scan = LaserScan(angle_increment=0.01, range_min=0.1, range_max=10.0, ranges=[1.5])

    def is_told() -> bool:
        publisher.publish(scan if told else b"")
        return len(told) > 1 and told[-1][0] != ()

    await until(is_told)
    assert told[0][0] == ()
    sectors, gid, sequence = told[-1]
    assert min(sectors) == 1.5
    assert sectors.count(inf) == 63
    assert len(gid) == 32
    assert sequence > told[0][2] > 0
