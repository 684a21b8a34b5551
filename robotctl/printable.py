"""Text that others chose, made safe to show and to log."""

from __future__ import annotations

import re

MAX_NAME = 120
"""Characters of a name that a sentence shows; the rest is cut, so that a line stays readable."""

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


def printable(text: object) -> str:
    """Return `text` on one line, with what is not plainly printable shown escaped."""
    line = str(text)
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def short_name(name: str) -> str:
    """Return a name of any length and content as a sentence shows it."""
    shown = printable(name[: MAX_NAME + 1])
    return shown if len(shown) <= MAX_NAME else f"{shown[: MAX_NAME - 3]}..."


def without_colours(text: str) -> str:
    """Return the text without what colours it: libraries do, and escaped it is noise."""
    return _COLOUR.sub("", text)
