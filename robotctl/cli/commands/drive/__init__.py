"""drive: drive a pattern, or a path from a file or a recording.

- `command`: declares the options and makes the request.
- `waypoint_file`: reads the points of a path; `recorded_path` those of a recording.
- `running`: waits for the end of a drive.
"""

from __future__ import annotations

from robotctl.cli.commands.drive.command import app
from robotctl.cli.commands.drive.running import tracking_lines

__all__ = ["app", "tracking_lines"]
