"""Text made safe to print and to log, and the names of the modes."""

from __future__ import annotations

import re

MAX_NAME = 120
"""The maximum length of a name in a message, in characters."""

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


def printable(text: object) -> str:
    """Return `text` on one line, with non-printable characters escaped."""
    line = str(text)
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def short_name(name: str) -> str:
    """Return a name for a message, escaped and cut to MAX_NAME characters."""
    shown = printable(name[: MAX_NAME + 1])
    return shown if len(shown) <= MAX_NAME else f"{shown[: MAX_NAME - 3]}..."


def without_colours(text: str) -> str:
    """Return `text` without the ANSI colour sequences that libraries add."""
    return _COLOUR.sub("", text)


MODES = {"idle": 0, "moving": 1, "error": 2, "emergency-stop": 3}
"""The number of each mode in robot_controller/msg/RobotStatus."""


def find_mode(text: str) -> int | None:
    """Return the number of mode `text`, a name (any case, - or _) or a number; None if unknown."""
    given = text.strip().lower().replace("_", "-")
    for name, number in MODES.items():
        if given in (name, str(number)):
            return number
    return None
