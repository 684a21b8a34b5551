"""The classic velocity publisher: drives a square by time, without odometry, while MOVING."""

import math
from contextlib import suppress
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot_controller.msg import RobotStatus

LINEAR_MPS, ANGULAR_RPS = 0.3, 1.0
FORWARD_S, TURN_S = 1.0 / LINEAR_MPS, math.pi / 2.0 / ANGULAR_RPS


class VelocityPublisher(Node):
    def __init__(self) -> None:
        super().__init__("velocity_publisher")
        rate_hz = self.declare_parameter("rate_hz", 50.0).value
        self.mode = RobotStatus.MODE_IDLE
        self.begun = self.get_clock().now()
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(RobotStatus, "robot_status", self.on_status, latched)
        self.create_timer(1.0 / rate_hz, self.tick)

    def on_status(self, status: Any) -> None:
        if status.mode != self.mode:
            self.mode = status.mode
            self.begun = self.get_clock().now()

    def tick(self) -> None:
        command = Twist()
        if self.mode == RobotStatus.MODE_MOVING:
            elapsed_s = (self.get_clock().now() - self.begun).nanoseconds / 1e9
            if elapsed_s % (FORWARD_S + TURN_S) < FORWARD_S:
                command.linear.x = LINEAR_MPS
            else:
                command.angular.z = ANGULAR_RPS
        self.publisher.publish(command)


def main() -> None:
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(VelocityPublisher())


if __name__ == "__main__":
    main()
