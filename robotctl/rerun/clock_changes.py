"""Finds where the wall clock of a recording was set, or the control loop stalled."""

from __future__ import annotations

from typing import Final, NamedTuple

from robotctl.kernel.types import Event, LoopStalled
from robotctl.kernel.units import NS_PER_S

CLOCK_NS = NS_PER_S // 4
"""If the offset between the clocks changes by more, the clock was set or the loop stalled."""

EXCUSES_NS = 2 * NS_PER_S
"""Wall-clock times are not compared if such a change is at most this far from them."""


class _Step(NamedTuple):
    """A change of the offset by `by_ns` from `level_ns`."""

    by_ns: int
    level_ns: int


class ClockChanges:
    """The changes of the wall clock against the steady clock of the journal.

    An entry may be recorded later than its event was stamped, never earlier. So the clock was set
    back where the wall clock goes back, and forward where the offset rises and stays high.
    """

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        """Wall clock - steady clock at the last moment."""

        self._wall_ns = 0
        self._changed_ns: list[int] = []
        self._set: list[_Step] = []

    @property
    def has_changed(self) -> bool:
        """Whether there was a change at all, by a stall or because the clock was set."""
        return bool(self._changed_ns)

    @property
    def set_by_ns(self) -> list[int]:
        """Each setting of the clock [ns]."""
        return [change.by_ns for change in self._set]

    @property
    def note(self) -> str:
        """A sentence about how often the clock was set, "" if it was not."""
        changes = self.set_by_ns
        if not changes:
            return ""
        often = "once" if len(changes) == 1 else f"{len(changes)} times"
        by_s = changes[0] / NS_PER_S
        return (
            f"the clock was set {often}, first by {by_s:+.2f} s: times around it are not compared"
        )

    def look(self, steady_ns: int, wall_ns: int) -> None:
        """Compare both clocks at one moment."""
        offset_ns, before_ns = wall_ns - steady_ns, self._offset_ns
        went_back, self._wall_ns = wall_ns < self._wall_ns, wall_ns
        self._offset_ns = offset_ns
        if before_ns is None:
            return
        by_ns = offset_ns - before_ns
        if abs(by_ns) > CLOCK_NS:
            self._changed_ns.append(steady_ns)
            if by_ns > 0 or went_back:
                self._set.append(_Step(by_ns, before_ns))
                return
        while self._set and self._set[-1].by_ns > 0 and self._is_level(offset_ns):
            self._set.pop()  # it was a stall

    def _is_level(self, offset_ns: int) -> bool:
        """Return whether the offset is what it was before its last rise."""
        return offset_ns <= self._set[-1].level_ns + CLOCK_NS

    def is_near(self, steady_ns: int) -> bool:
        """Return whether the offset between the clocks changed within EXCUSES_NS of this time."""
        return any(abs(steady_ns - at_ns) <= EXCUSES_NS for at_ns in self._changed_ns)


RECENT_NS: Final = 2 * NS_PER_S
"""A stall that ended at most this long before the journal did may have delayed its last inputs."""


class RecordedStalls:
    """Collects the stalls of the control loop; `longest_ns` is the duration of the longest."""

    def __init__(self) -> None:
        self.longest_ns = 0
        self._ends: list[tuple[int, int]] = []
        """The steady time at which each stall ended, and its duration [ns]."""

    def step(self, event: Event) -> None:
        """Note a stall; other events change nothing."""
        if isinstance(event, LoopStalled):
            stalled_ns = round(event.stalled_s * NS_PER_S)
            self.longest_ns = max(self.longest_ns, stalled_ns)
            self._ends.append((event.t_ns, stalled_ns))

    def recent_ns(self, end_ns: int) -> int:
        """Return how long the stalls lasted that ended just before `end_ns`, at most RECENT_NS."""
        recent = (stalled_ns for t_ns, stalled_ns in self._ends if t_ns > end_ns - RECENT_NS)
        return min(sum(recent), RECENT_NS)
