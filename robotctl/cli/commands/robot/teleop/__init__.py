"""teleop: drive by hand, with keys or a gamepad that must be held.

- `command`: declares the options, runs the session, and draws its screen.
- `controls`: turns keys or a gamepad into the wanted motion, and requests it from the daemon.
"""

from robotctl.cli.commands.robot.teleop.command import app

__all__ = ["app"]
