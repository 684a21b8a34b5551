"""The ROS types of a velocity command."""

from typing import Final

TWIST: Final = "geometry_msgs/msg/Twist"
TWIST_STAMPED: Final = "geometry_msgs/msg/TwistStamped"
COMMAND_TYPES: Final = frozenset({TWIST, TWIST_STAMPED})
