"""The ROS types of odometry and of our own topics; those of commands: `kernel.command_types`."""

from __future__ import annotations

from typing import Final

ODOMETRY: Final = "nav_msgs/msg/Odometry"
ROBOT_STATUS: Final = "robot_controller/msg/RobotStatus"
JOURNAL_ENTRY: Final = "robot_controller/msg/JournalEntry"
