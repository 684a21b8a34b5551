"""teleop: drive by hand, with keys or a gamepad that must be held.

- `command`: declares the options; the session from start to end, and what it shows.
- `controls`: what the operator wants now, by keys or gamepad, and how the daemon is asked for it.
"""

from robotctl.cli.commands.robot.teleop.command import app

__all__ = ["app"]
