"""The level of a battery, to and from sensor_msgs/BatteryState."""

from __future__ import annotations

from math import nan
from typing import Any

from sensor_msgs.msg import BatteryState

from robotctl.kernel.units import NS_PER_S


def to_battery_level(message: Any) -> float:
    """Return the level of a BatteryState as its publisher reports it.

    REP-147 and the message ask for 0..1; `battery.scale` tells the kernel of other scales.
    """
    return float(message.percentage)


def battery_message(level: float, stamp_ns: int) -> BatteryState:
    """Return a BatteryState of this level; what is not measured is NaN."""
    message = BatteryState()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS_PER_S)
    message.percentage = level
    message.voltage = message.current = message.charge = nan
    message.capacity = message.design_capacity = message.temperature = nan
    message.present = True
    message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message
