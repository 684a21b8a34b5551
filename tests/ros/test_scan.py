"""Laser scans: the nearest ranges by direction, as LaserScan and REP-117 define them."""

from __future__ import annotations

import struct
from math import inf, nan, tau

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan

from robotctl.messages.inputs import MAX_RAYS, SECTORS, nearest_by_sector


def scan(ranges: list[float], angle_min: float = -3.13, **fields: float) -> bytes:
    increment = tau / max(len(ranges), 1)
    message = LaserScan(
        angle_min=angle_min, angle_increment=increment, range_min=0.1, range_max=10.0
    )
    message.ranges = ranges
    message.header.frame_id = "laser"
    for name, value in fields.items():
        setattr(message, name, value)
    return serialize_message(message)


@pytest.mark.parametrize(
    ("value", "nearest"),
    [(1.5, 1.5), (0.05, inf), (0.0, inf), (11.0, inf), (nan, inf), (inf, inf), (-inf, 0.0)],
)
def test_a_range_means_what_the_message_and_rep_117_say(value: float, nearest: float) -> None:
    assert nearest_by_sector(scan([value])) == (nearest, *[inf] * (SECTORS - 1))


def test_each_direction_has_its_sector() -> None:
    ranges = [1.0 + number / 100 for number in range(4 * SECTORS)]
    nearest = nearest_by_sector(scan(ranges))
    assert nearest == tuple(pytest.approx(1.0 + n / 25, abs=0.02) for n in range(SECTORS))


@given(st.lists(st.floats(width=32), max_size=200), st.floats(-20, 20, width=32))
def test_any_ranges_give_as_many_numbers_and_never_nan(ranges: list[float], angle: float) -> None:
    nearest = nearest_by_sector(scan(ranges, angle))
    assert len(nearest) == SECTORS
    assert all(each >= 0.0 for each in nearest)


def test_a_hundred_thousand_rays_are_read() -> None:
    assert min(nearest_by_sector(scan([2.0] * 100_000))) == 2.0


# Named, for rmw leaves the padding of a message as it was: each process has other bytes there.
@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"", id="empty"),
        pytest.param(scan([1.0])[:-9], id="cut"),
        pytest.param(scan([1.0], angle_min=nan), id="begins nowhere"),
        pytest.param(scan([1.0], angle_increment=inf), id="endless step"),
        pytest.param(scan([1.0] * (MAX_RAYS + 1)), id="too many rays"),
    ],
)
def test_what_is_no_scan_is_refused(data: bytes) -> None:
    with pytest.raises(struct.error):
        nearest_by_sector(data)
