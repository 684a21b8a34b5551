"""The level in sensor_msgs/BatteryState, without ROS."""

from __future__ import annotations

from math import nan

from robotctl.cdr.reader import CdrReader

_PERCENTAGE = 6
"""The place of the level among the float32 fields that follow the header."""


def read_battery_level(data: bytes) -> float:
    """Return the level of a serialized BatteryState as its publisher reports it, NaN if unreadable.

    REP-147 and the message ask for 0..1; `battery.scale` tells the kernel of other scales.
    """
    try:
        message = CdrReader(data)
        message.take("i")
        message.take("I")
        message.text()
        return float(message.take("f", _PERCENTAGE + 1)[_PERCENTAGE])
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return nan
