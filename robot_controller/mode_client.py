"""Asks for a mode; run: python -m robot_controller.mode_client MOVING."""

from robotctl import environment

if __name__ == "__main__":
    environment.prepare()  # before rclpy is imported

from robotctl.ros.executables.mode_client import ask, main, mode_of

__all__ = ["ask", "main", "mode_of"]

if __name__ == "__main__":
    raise SystemExit(main())
