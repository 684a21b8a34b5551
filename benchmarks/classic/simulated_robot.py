"""The classic simulated robot: the same physics as robotctl's own, in a plain node."""

import math
from contextlib import suppress
from typing import Any

import rclpy
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState

from robotctl.kernel.types import Twist
from robotctl.sim import Robot, SimParams


class SimulatedRobot(Node):
    def __init__(self) -> None:
        super().__init__("simulated_robot")
        rate_hz = self.declare_parameter("rate_hz", 50.0).value
        self.robot = Robot(SimParams())
        self.last = self.get_clock().now()
        self.odometry = self.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self.battery = self.create_publisher(BatteryState, "battery_state", qos_profile_sensor_data)
        self.create_subscription(TwistMessage, "cmd_vel", self.on_command, 10)
        self.create_timer(1.0 / rate_hz, self.move)
        self.create_timer(1.0, self.publish_battery)

    def on_command(self, command: Any) -> None:
        self.robot.command(Twist(command.linear.x, command.angular.z))

    def move(self) -> None:
        now = self.get_clock().now()
        self.robot.advance((now - self.last).nanoseconds / 1e9)
        self.last = now
        pose, velocity = self.robot.odometry, self.robot.measured
        message = Odometry()
        message.header.stamp = now.to_msg()
        message.header.frame_id = "odom"
        message.child_frame_id = "base_link"
        message.pose.pose.position.x = pose.x
        message.pose.pose.position.y = pose.y
        message.pose.pose.orientation.z = math.sin(pose.theta / 2.0)
        message.pose.pose.orientation.w = math.cos(pose.theta / 2.0)
        message.twist.twist.linear.x = velocity.linear
        message.twist.twist.angular.z = velocity.angular
        self.odometry.publish(message)

    def publish_battery(self) -> None:
        message = BatteryState(percentage=self.robot.battery, present=True)
        message.header.stamp = self.get_clock().now().to_msg()
        self.battery.publish(message)


def main() -> None:
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(SimulatedRobot())


if __name__ == "__main__":
    main()
