"""Between ROS messages and the values of the kernel: the only place that knows both."""

from __future__ import annotations

from math import nan
from typing import Any

from sensor_msgs.msg import BatteryState

from robotctl.kernel.geometry import Pose, yaw_of
from robotctl.kernel.types import Odometry, Twist

NS_PER_S = 1_000_000_000


def to_odometry(message: Any) -> Odometry:
    """Return pose (x, y, yaw), velocity and header stamp of a nav_msgs/Odometry."""
    position, q = message.pose.pose.position, message.pose.pose.orientation
    twist = message.twist.twist
    stamp = message.header.stamp
    return Odometry(
        Pose(position.x, position.y, yaw_of(q.x, q.y, q.z, q.w)),
        Twist(twist.linear.x, twist.angular.z),
        stamp.sec * NS_PER_S + stamp.nanosec,
    )


def to_twist(message: Any) -> Twist:
    """Return forward and turning velocity of a geometry_msgs/Twist."""
    return Twist(message.linear.x, message.angular.z)


def to_battery_level(message: Any) -> float:
    """Return the level of a sensor_msgs/BatteryState as it is reported.

    REP-147 and the message ask for 0..1; the kernel knows what `battery.scale` says of others.
    """
    return float(message.percentage)


def battery_message(level: float, stamp_ns: int) -> BatteryState:
    """Return a BatteryState with this level, and unknown (NaN) where nothing was measured."""
    message = BatteryState()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS_PER_S)
    message.percentage = level
    message.voltage = message.current = message.charge = nan
    message.capacity = message.design_capacity = message.temperature = nan
    message.present = True
    message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message
