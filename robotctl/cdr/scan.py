"""The nearest ranges of a serialized sensor_msgs/LaserScan, by direction."""

from __future__ import annotations

import struct
from math import inf, isfinite, pi, tau

import numpy as np

from robotctl.cdr.reader import CdrReader

SECTORS = 64
"""Sector n holds the directions from -pi + n * tau / 64 on, in the frame of the scanner."""

MAX_RAYS = 200_000


def nearest_by_sector(data: bytes) -> tuple[float, ...]:
    """Return the nearest range in each sector [m, to 1 mm], inf where nothing is.

    As the message defines it, ranges outside range_min and range_max are discarded, and so is NaN;
    by REP-117 -inf is an object too close to measure: 0, and inf is none.

    Raises:
        struct.error: The message is cut short, not in plain CDR, or has no sensible angles.
    """
    message = CdrReader(data)
    message.take("i"), message.take("I")
    message.text()
    angle_min, _, increment, _, _, range_min, range_max = message.take("f", 7)
    (count,) = message.take("I")
    if not isfinite(angle_min + increment) or count > MAX_RAYS:
        raise struct.error(f"a scan of {count} rays from {angle_min} in steps of {increment}")
    ranges = np.array(message.take("f", count), dtype=np.float64)
    angles = angle_min + increment * np.arange(count)
    sectors = np.floor((angles + pi) % tau / tau * SECTORS).astype(np.intp) % SECTORS
    is_valid = (ranges >= range_min) & (ranges <= range_max) & np.isfinite(ranges)
    distances = np.where(ranges == -inf, 0.0, np.where(is_valid, ranges, inf))
    nearest = np.full(SECTORS, inf)
    np.minimum.at(nearest, sectors, distances)
    return tuple(round(float(each), 3) for each in nearest)


def read_sectors(data: bytes) -> tuple[float, ...]:
    """Return the nearest range in each sector, () for an unreadable message."""
    try:
        return nearest_by_sector(data)
    except struct.error:
        return ()
