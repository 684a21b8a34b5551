"""The ROS executables: one node per process, for `ros2 run`, launch files and shells.

Each function is a console script. It prepares the environment before anything imports rclpy.
"""

from __future__ import annotations

from robotctl import environment


def velocity_publisher() -> int:
    """Run node `velocity_publisher` until Ctrl-C; return the exit code."""
    environment.prepare()
    from robotctl.ros.executables.velocity_publisher import main

    return main()


def odom_subscriber() -> int:
    """Run node `odom_subscriber` until Ctrl-C; return the exit code."""
    environment.prepare()
    from robotctl.ros.executables.odom_subscriber import main

    return main()


def mode_service() -> int:
    """Run node `mode_service` until Ctrl-C; return the exit code."""
    environment.prepare()
    from robotctl.ros.executables.mode_service import main

    return main()


def mode_client() -> int:
    """Request a mode, print the response, and return the exit code."""
    environment.prepare()
    from robotctl.ros.executables.mode_client import main

    return main()
