"""What was done to a recordings folder, for whoever reads the log."""

from __future__ import annotations

from typing import NamedTuple


class TidyNote(NamedTuple):
    """One thing that was done, or could not be done."""

    text: str
    problem: bool = False
    """Something is lost, or somebody has to see to it."""
