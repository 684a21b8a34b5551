"""drive: drive a pattern, or a path from a file or a recording.

- `command`: declares the options and makes the request.
- `paths`: reads the points of a path from a file or a recording.
- `running`: waits for the end of a drive, and draws its picture.
"""

from __future__ import annotations

from robotctl.cli.commands.robot.drive.command import MOTIONS, app
from robotctl.cli.commands.robot.drive.running import tracking_lines

__all__ = ["MOTIONS", "app", "tracking_lines"]
