"""Errors for damaged parts of a file."""

from __future__ import annotations

from robotctl.recording.read.read_limits import CURE


class Damaged(Exception):
    """A part of the file cannot be read. The text says what is wrong, without the file name."""


class Unreadable(Damaged):
    """The disk or the memory failed; the same part may be readable later."""


class BeyondLimit(Damaged):
    """Reading on would exceed the limits of `read_limits`. The text says how to raise them."""

    def __init__(self, what: str) -> None:
        """Take the sentence without the cure."""
        super().__init__(f"{what} ({CURE})")
