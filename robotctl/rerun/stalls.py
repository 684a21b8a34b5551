"""The stalls of the control loop in a journal: what is handled then comes later than otherwise."""

from __future__ import annotations

from typing import Final

from robotctl.kernel.types import Event, LoopStalled
from robotctl.kernel.units import NS_PER_S

RECENT_NS: Final = 2 * NS_PER_S
"""Stalls that ended within this time before the end may hold up its last messages."""


class RecordedStalls:
    """The times of the stalls."""

    def __init__(self) -> None:
        self.longest_ns = 0
        self._ends: list[tuple[int, int]] = []
        """When each ended, and how long it was."""

    def step(self, event: Event) -> None:
        """Take an event of the journal."""
        if isinstance(event, LoopStalled):
            stalled_ns = round(event.stalled_s * NS_PER_S)
            self.longest_ns = max(self.longest_ns, stalled_ns)
            self._ends.append((event.t_ns, stalled_ns))

    def recent_ns(self, end_ns: int) -> int:
        """Return how long the loop was stalled shortly before a time, at most RECENT_NS."""
        recent = (stalled_ns for t_ns, stalled_ns in self._ends if t_ns > end_ns - RECENT_NS)
        return min(sum(recent), RECENT_NS)
