"""The classic odometry subscriber: keeps the latest pose."""

import math
from contextlib import suppress
from typing import Any

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data


class OdomSubscriber(Node):
    def __init__(self) -> None:
        super().__init__("odom_subscriber")
        self.pose = (0.0, 0.0, 0.0)
        self.create_subscription(Odometry, "odom", self.on_odometry, qos_profile_sensor_data)

    def on_odometry(self, odometry: Any) -> None:
        position = odometry.pose.pose.position
        q = odometry.pose.pose.orientation
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
        self.pose = (position.x, position.y, yaw)


def main() -> None:
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OdomSubscriber())


if __name__ == "__main__":
    main()
