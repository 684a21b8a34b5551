"""The classic mode service: sets the mode, and publishes the status once a second."""

from contextlib import suppress
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode
from sensor_msgs.msg import BatteryState


class ModeService(Node):
    def __init__(self) -> None:
        super().__init__("mode_service")
        self.status = RobotStatus(robot_name="robot", is_connected=True)
        self.status.mode = self.declare_parameter("mode", RobotStatus.MODE_IDLE).value
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.publisher = self.create_publisher(RobotStatus, "robot_status", latched)
        self.create_subscription(
            BatteryState, "battery_state", self.on_battery, qos_profile_sensor_data
        )
        self.create_service(SetMode, "set_mode", self.set_mode)
        self.create_timer(1.0, self.publish)

    def on_battery(self, battery: Any) -> None:
        self.status.battery_level = battery.percentage

    def set_mode(self, request: Any, response: Any) -> Any:
        response.success = request.requested_mode <= RobotStatus.MODE_EMERGENCY_STOP
        if response.success:
            self.status.mode = request.requested_mode
            self.publish()
        response.current_mode = self.status.mode
        return response

    def publish(self) -> None:
        self.publisher.publish(self.status)


def main() -> None:
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(ModeService())


if __name__ == "__main__":
    main()
