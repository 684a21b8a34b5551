"""Finds where the wall clock of a recording was set, or the control loop stalled."""

from __future__ import annotations

from typing import Final, NamedTuple

from robotctl.kernel.types import Event, LoopStalled
from robotctl.kernel.units import NS_PER_S

CLOCK_NS = NS_PER_S // 4
"""If the offset between the clocks changes by more, the clock was set or the loop stalled."""

EXCUSES_NS = 2 * NS_PER_S
"""Wall-clock times are not compared if such a change is at most this far from them."""


class _ClockStep(NamedTuple):
    """A change of the wall clock by `by_ns`, found at the `moment`-th comparison."""

    moment: int
    by_ns: int


class ClockChanges:
    """Finds the changes of the wall clock against the steady clock of the journal."""

    def __init__(self) -> None:
        self.offset_ns: int | None = None
        """Wall clock - steady clock at the last `look`."""

        self._begun_ns: int | None = None
        """Wall clock - steady clock at the first snapshot."""

        self._changed_ns: list[int] = []
        self._set: list[_ClockStep] = []
        self._moments = 0
        self._wall_ns = 0

    @property
    def has_changed(self) -> bool:
        """Whether there was a change at all."""
        return bool(self._changed_ns)

    @property
    def set_by_ns(self) -> list[int]:
        """By how much the clock was set each time [ns], except before the first `look`."""
        return [change.by_ns for change in self._set if change.moment > 1]

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

    def begin(self, steady_ns: int, wall_ns: int) -> None:
        """Store the offset between the clocks at the first snapshot; later calls do nothing."""
        if self._begun_ns is None:
            self._begun_ns = wall_ns - steady_ns

    def look(self, steady_ns: int, wall_ns: int) -> None:
        """Note a change if the offset between the clocks has changed since the last `look`."""
        offset_ns = wall_ns - steady_ns
        before_ns, self.offset_ns = self.offset_ns, offset_ns
        self._moments += 1
        is_first = before_ns is None
        before_ns = self._begun_ns if before_ns is None else before_ns
        if before_ns is not None and abs(offset_ns - before_ns) > CLOCK_NS:
            if not is_first:
                self._changed_ns.append(steady_ns)
            self._take(offset_ns - before_ns, wall_ns)
        self._wall_ns = wall_ns

    def _take(self, by_ns: int, wall_ns: int) -> None:
        """Note that the clock was set, or drop the last change if this one undoes it.

        An undone change was a stall between reading the two clocks: the wall clock did not go back.
        """
        last = self._set[-1] if self._set else None
        is_undone = last is not None and last.moment == self._moments - 1 and last.by_ns > 0
        if is_undone and by_ns < 0 and wall_ns >= self._wall_ns:
            self._set.pop()
        else:
            self._set.append(_ClockStep(self._moments, by_ns))

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
