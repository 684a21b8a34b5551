"""Requests a mode; run: python -m robot_controller.mode_client MOVING."""

from robotctl.ros import executables

if __name__ == "__main__":
    raise SystemExit(executables.mode_client())

from robotctl.ros.executables.mode_client import ask, main, mode_of

__all__ = ["ask", "main", "mode_of"]
