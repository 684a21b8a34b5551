"""Checks that a journal holds the measurements in the order in which they were received.

Ticks are left out: their time is the one at which they are due.
"""

from __future__ import annotations

from typing import Final

from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    SafetyInputReceived,
    ScanReceived,
)
from robotctl.kernel.units import NS_PER_S

MEASUREMENTS: Final = frozenset(
    {OdomReceived, BatteryReceived, ScanReceived, GuardedCommandReceived, SafetyInputReceived}
)
"""The events that are stamped when they are received."""

SLACK_NS: Final = NS_PER_S // 1_000
"""How much earlier than the one before a measurement may be."""


class MeasurementOrder:
    """The times of the measurements."""

    def __init__(self) -> None:
        self.swapped = 0
        """The number of measurements that are earlier than one before them."""

        self.first_seq = 0
        """The number of the entry of the first of them."""

        self._newest_ns: int | None = None

    def step(self, event: Event, seq: int) -> None:
        """Take an event, with the number of its entry."""
        if type(event) not in MEASUREMENTS:
            return
        if self._newest_ns is not None and event.t_ns < self._newest_ns - SLACK_NS:
            self.first_seq = self.first_seq or seq
            self.swapped += 1
        self._newest_ns = max(event.t_ns, self._newest_ns or event.t_ns)

    def stop(self) -> None:
        """Begin again: events are missing."""
        self._newest_ns = None
