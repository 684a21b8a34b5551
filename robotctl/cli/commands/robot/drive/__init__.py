"""drive: drive a pattern, a velocity, or a path from a file, a recording or a topic.

- `command`: declares the options and makes the request.
- `paths`: reads the points of a path from a file, a recording or a topic.
- `running`: waits for the end of a drive, and draws its picture.
"""

from __future__ import annotations

from robotctl.cli.commands.robot.drive.command import MOTIONS, app
from robotctl.cli.commands.robot.drive.running import tracking_lines

__all__ = ["MOTIONS", "app", "tracking_lines"]
