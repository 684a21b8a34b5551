"""OdomSubscriber, the node of `python -m robot_controller.odom_subscriber`."""

from robotctl.ros import executables

if __name__ == "__main__":
    raise SystemExit(executables.odom_subscriber())

from robotctl.ros.executables.odom_subscriber import OdomSubscriber, main

__all__ = ["OdomSubscriber", "main"]
