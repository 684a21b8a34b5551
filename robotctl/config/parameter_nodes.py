"""Which node of the daemon declares a key as its ROS parameter."""

from __future__ import annotations

from typing import Final

MODE_SERVICE: Final = "mode_service"
SIMULATED_ROBOT: Final = "simulated_robot"

PREFIXES: Final = {
    "velocity_publisher": (
        *("rate_hz", "max_tick_gap_s", "fifo_priority", "standalone"),
        *("command.", "limits.", "tracking.", "pattern."),
    ),
    "odom_subscriber": ("odometry.",),
    SIMULATED_ROBOT: ("sim.",),
    MODE_SERVICE: ("",),
}
"""The beginnings of the keys that a node declares; the first node that fits has the key."""

NODES: Final = tuple(PREFIXES)
"""The nodes that have parameters."""


def node_of(key: str) -> str:
    """Return the name of the node that declares a key."""
    return next(node for node, prefixes in PREFIXES.items() if key.startswith(prefixes))
