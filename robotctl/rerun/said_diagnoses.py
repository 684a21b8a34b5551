"""Whether each diagnosis in a journal was said by a recorded message.

A diagnosis in the journal is the worst that the control loop knows of, so it need not be in the
message with which it came.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from math import isnan
from typing import Final

from robotctl.cdr.safety_inputs import statuses

MAX_SAID: Final = 100_000
"""The number of different diagnoses that are remembered; with more, they are not compared."""


class SaidDiagnoses:
    """The diagnoses in the messages of a recording, and those in its journal: level and text."""

    def __init__(self, robot: str) -> None:
        """`robot` is the robot whose own diagnoses do not count."""
        self._robot = robot
        self._said: set[tuple[float, str]] = {(0.0, "")}
        self._heard: set[tuple[float, str]] = set()

    def message(self, data: bytes) -> None:
        """Take a DiagnosticArray."""
        if len(self._said) < MAX_SAID:
            with suppress(struct.error):
                self._said |= {(level, text) for _, level, text in statuses(self._robot, data)}

    def heard(self, level: float, text: str) -> None:
        """Take a diagnosis of the journal; NaN is an unreadable message."""
        if len(self._heard) < MAX_SAID and not isnan(level):
            self._heard.add((level, text))

    def unsaid(self) -> list[str]:
        """Return the texts of the diagnoses that no message said."""
        if max(len(self._said), len(self._heard)) >= MAX_SAID:
            return []
        return sorted(f"level {level:g}, {text}" for level, text in self._heard - self._said)
