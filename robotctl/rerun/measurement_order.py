"""Checks that a journal holds the measurements in the order in which they were received.

Ticks are left out: their time is the one at which they are due.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from robotctl.kernel.types import Event
from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.agreed import Agreed
from robotctl.rerun.ordinary_run import MEASUREMENTS

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

    def run(self, steps: Sequence[Agreed]) -> None:
        """Take many events."""
        measured = [step for step in steps if type(step.event) in MEASUREMENTS]
        times_ns = [step.event.t_ns for step in measured]
        if times_ns == sorted(times_ns):
            measured = [measured[0], measured[-1]] if measured else []
        for step in measured:
            self.step(step.event, step.seq)

    def stop(self) -> None:
        """Begin again: events are missing."""
        self._newest_ns = None
