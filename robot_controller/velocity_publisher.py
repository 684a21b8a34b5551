"""VelocityPublisher, the node of `python -m robot_controller.velocity_publisher`."""

from robotctl.ros import executables

if __name__ == "__main__":
    raise SystemExit(executables.velocity_publisher())

from robotctl.ros.executables.velocity_publisher import VelocityPublisher, main

__all__ = ["VelocityPublisher", "main"]
