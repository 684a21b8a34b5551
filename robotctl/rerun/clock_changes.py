"""Finds where the wall clock of a recording was set, or the control loop stalled."""

from __future__ import annotations

from robotctl.kernel.units import NS_PER_S

CLOCK_NS = NS_PER_S // 4
"""A larger change between wall clock and steady clock: the clock was set, or the loop stalled."""

EXCUSES_NS = 2 * NS_PER_S
"""How near to such a change wall-clock times are not compared."""


class ClockChanges:
    """The changes of the wall clock against the steady clock of the journal."""

    def __init__(self) -> None:
        self.offset_ns: int | None = None
        """Wall clock - steady clock at the last moment."""

        self._changed_ns: list[int] = []

    @property
    def has_changed(self) -> bool:
        """Whether there was a change at all."""
        return bool(self._changed_ns)

    def look(self, steady_ns: int, wall_ns: int) -> None:
        """Take one moment by both clocks."""
        offset_ns = wall_ns - steady_ns
        before_ns, self.offset_ns = self.offset_ns, offset_ns
        if before_ns is not None and abs(offset_ns - before_ns) > CLOCK_NS:
            self._changed_ns.append(steady_ns)

    def is_near(self, steady_ns: int) -> bool:
        """Return whether a change was near to this moment."""
        return any(abs(steady_ns - at_ns) <= EXCUSES_NS for at_ns in self._changed_ns)
