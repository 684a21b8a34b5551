"""Units of time, and the types of a velocity command."""

from __future__ import annotations

from typing import Final

NS_PER_S: Final = 1_000_000_000
DAY_S: Final = 86_400.0


TWIST: Final = "geometry_msgs/msg/Twist"
TWIST_STAMPED: Final = "geometry_msgs/msg/TwistStamped"
COMMAND_TYPES: Final = frozenset({TWIST, TWIST_STAMPED})
