"""What is wrong with a part of a file."""

from __future__ import annotations

from robotctl.recording.read.read_limits import CURE


class Damaged(Exception):
    """A part of the file cannot be read; the text says what is wrong, without naming the file."""


class Unreadable(Damaged):
    """The disk or the memory failed; at another time the same part may be readable."""


class BeyondLimit(Damaged):
    """Reading on would take more work than `read_limits` allows; the text says how to allow it."""

    def __init__(self, what: str) -> None:
        """`what` is the sentence without the cure."""
        super().__init__(f"{what} ({CURE})")
