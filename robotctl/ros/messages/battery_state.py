"""The level of a battery as sensor_msgs/BatteryState."""

from __future__ import annotations

from math import nan

from sensor_msgs.msg import BatteryState

from robotctl.kernel.units import NS_PER_S


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
