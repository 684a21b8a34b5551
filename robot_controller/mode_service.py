"""ModeService, the node of `python -m robot_controller.mode_service`."""

from robotctl.ros import executables

if __name__ == "__main__":
    raise SystemExit(executables.mode_service())

from robotctl.ros.executables.mode_service import ModeService, main

__all__ = ["ModeService", "main"]
