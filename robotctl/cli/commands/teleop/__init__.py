"""teleop: drive by hand, with keys or a gamepad that must be held.

- `held_keys`, `gamepad`: what the operator wants now.
- `holding`: asks the daemon for it, again and again.
- `session`: the loop around both; `screen`: what is shown.
"""

from robotctl.cli.commands.teleop.command import app

__all__ = ["app"]
