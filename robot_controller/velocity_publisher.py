"""VelocityPublisher, the node of `python -m robot_controller.velocity_publisher`."""

from robotctl import environment

if __name__ == "__main__":
    environment.prepare()  # before rclpy is imported

from robotctl.ros.executables.velocity_publisher import VelocityPublisher, main

__all__ = ["VelocityPublisher", "main"]

if __name__ == "__main__":
    raise SystemExit(main())
