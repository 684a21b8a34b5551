"""ModeService, the node of `python -m robot_controller.mode_service`."""

from robotctl import environment

if __name__ == "__main__":
    environment.prepare()  # before rclpy is imported

from robotctl.ros.executables.mode_service import ModeService, main

__all__ = ["ModeService", "main"]

if __name__ == "__main__":
    raise SystemExit(main())
