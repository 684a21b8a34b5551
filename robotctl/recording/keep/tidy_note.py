"""What was done to a recordings folder, for the log."""

from __future__ import annotations

from typing import NamedTuple


class TidyNote(NamedTuple):
    """One action, or a failure."""

    text: str
    problem: bool = False
    """Whether data is lost, or a user must do something."""

    removed: str = ""
    """The path of a file that retention removed."""
