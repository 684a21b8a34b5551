"""A robot's base as a process: it takes commands, and tells odometry and battery."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from typing import Any

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, qos_profile_system_default
from sensor_msgs.msg import BatteryState

from tests.support.lines import obey

QOS = {"system": qos_profile_system_default, "sensor": qos_profile_sensor_data}
COMMANDS = {"Twist": Twist, "TwistStamped": TwistStamped}


class StubBase:
    def __init__(self) -> None:
        self.node = Node("stub_base")
        self.frames: set[str] = set()
        self._velocity = self._wanted = (0.0, 0.0)
        self._heard_s = 0.0
        self._pose = (0.0, 0.0, 0.0)
        self._thread: threading.Thread | None = None

    def begin(
        self,
        command: list[str],
        odometry: list[Any],
        battery: list[Any] | None,
        child_frame: str,
        lag_s: float = 0.0,
        deadband_mps: float = 0.0,
        timeout_s: float | None = None,
    ) -> None:
        """Be a base; topic, type and QoS of the command; topic, QoS and rate [Hz] of the others.

        It follows with a lag, no speed below the deadband, and stops at its timeout, if any.
        """
        self._lag_s, self._deadband_mps = lag_s, deadband_mps
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        topic, kind, profile = command
        self.node.create_subscription(COMMANDS[kind], topic, self._take, QOS[profile])
        self._child_frame = child_frame
        name, profile, rate_hz = odometry
        self._odometry = self.node.create_publisher(Odometry, name, QOS[profile])
        self._period_s = 1.0 / rate_hz
        self.node.create_timer(self._period_s, self._move)
        if battery is not None:
            name, profile, rate_hz, level = battery
            self._battery = self.node.create_publisher(BatteryState, name, QOS[profile])
            message = BatteryState(percentage=level)
            self.node.create_timer(1.0 / rate_hz, lambda: self._battery.publish(message))
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def driven(self) -> dict[str, Any]:
        """Return where it is [m], and the frames of the commands it took."""
        x, y, _ = self._pose
        return {"x": x, "y": y, "frames": sorted(self.frames)}

    def end(self) -> None:
        """Leave the graph."""
        rclpy.shutdown()
        if self._thread is not None:
            self._thread.join()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            rclpy.spin(self.node)

    def _take(self, message: Any) -> None:
        if isinstance(message, TwistStamped):
            self.frames.add(message.header.frame_id)
            message = message.twist
        self._wanted = (message.linear.x, message.angular.z)
        self._heard_s = time.monotonic()

    def _follow(self) -> tuple[float, float]:
        """Return the velocity of this period."""
        (v, w), (wanted_v, wanted_w) = self._velocity, self._wanted
        is_heard = time.monotonic() - self._heard_s < self._timeout_s
        if not is_heard or 0.0 < abs(wanted_v) < self._deadband_mps:
            wanted_v, wanted_w = 0.0, 0.0
        share = 1.0 - math.exp(-self._period_s / self._lag_s) if self._lag_s else 1.0
        return v + share * (wanted_v - v), w + share * (wanted_w - w)

    def _move(self) -> None:
        self._velocity = self._follow()
        (v, w), (x, y, theta) = self._velocity, self._pose
        x += v * math.cos(theta) * self._period_s
        y += v * math.sin(theta) * self._period_s
        theta += w * self._period_s
        self._pose = (x, y, theta)
        message = Odometry()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "odom", self._child_frame
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z = math.sin(theta / 2)
        message.pose.pose.orientation.w = math.cos(theta / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = v, w
        self._odometry.publish(message)


if __name__ == "__main__":
    rclpy.init()
    base = StubBase()
    try:
        obey(base)
    finally:
        base.end()
