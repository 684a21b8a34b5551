"""The names of the modes as users write them. No imports: quick commands load this module."""

from __future__ import annotations

MODES = {"idle": 0, "moving": 1, "error": 2, "emergency-stop": 3}
"""The number of each mode in robot_controller/msg/RobotStatus."""


def find_mode(text: str) -> int | None:
    """Return the number of a mode by its name (any case, with - or _) or number, or None."""
    given = text.strip().lower().replace("_", "-")
    for name, number in MODES.items():
        if given in (name, str(number)):
            return number
    return None
