"""The ROS executables: one node per process, for `ros2 run`, launch files and shells.

Each public function is a console script, and returns the exit code.
"""

from __future__ import annotations

import sys
from importlib import import_module

from robotctl.base import environment
from robotctl.base.errors import RobotctlError
from robotctl.base.own_process import open_standard_streams
from robotctl.base.ros_arguments import with_log_levels


def velocity_publisher() -> int:
    """Run node `velocity_publisher` until Ctrl-C."""
    return _run("velocity_publisher")


def odom_subscriber() -> int:
    """Run node `odom_subscriber` until Ctrl-C."""
    return _run("odom_subscriber")


def mode_service() -> int:
    """Run node `mode_service` until Ctrl-C."""
    return _run("mode_service")


def mode_client() -> int:
    """Request a mode from the service `set_mode`, and print the response."""
    return _run("mode_client")


def _run(name: str) -> int:
    """Prepare the environment before anything imports rclpy, then run `main` of module `name`."""
    open_standard_streams()
    try:
        sys.argv = with_log_levels(sys.argv)
        environment.prepare()
        code: int = import_module(f"{__name__}.{name}").main()
    except KeyboardInterrupt:
        print("Shutting down ...", file=sys.stderr)
        return 0
    except RobotctlError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return error.exit_code
    return code
