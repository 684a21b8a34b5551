"""When a recorded moment is due: a straight line, until a pause or a change of rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

from robotctl.replay.job import MAX_RATE, MIN_RATE

_STEPS: Final = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""The rates that keys select, in each power of ten."""

RATES: Final = tuple(
    round(step * 10.0**power, 4)
    for power in range(-3, 5)
    for step in _STEPS
    if MIN_RATE <= round(step * 10.0**power, 4) <= MAX_RATE
)


@dataclass(frozen=True, slots=True)
class Schedule:
    """Recorded time `at_ns` is due at `moment_ns` of the steady clock, later times by `rate`.

    With a rate of None everything is due at once. While `paused` nothing is due.
    """

    moment_ns: int
    at_ns: int
    rate: float | None
    paused: bool = False

    def due_ns(self, at_ns: int) -> int:
        """Return when a recorded moment is due if the schedule does not change."""
        if self.rate is None:
            return self.moment_ns
        return self.moment_ns + round((at_ns - self.at_ns) / self.rate)

    def position_ns(self, now_ns: int) -> int:
        """Return the recorded moment that is due at `now_ns`."""
        if self.paused or self.rate is None:
            return self.at_ns
        return self.at_ns + max(round((now_ns - self.moment_ns) * self.rate), 0)

    def pause(self, now_ns: int) -> Self:
        """Return the schedule that is paused from now on."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), paused=True)

    def resume(self, now_ns: int) -> Self:
        """Return the schedule that continues from its position."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), paused=False)

    def with_rate(self, now_ns: int, rate: float) -> Self:
        """Return the schedule that continues at another rate."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), rate=rate)


def faster(rate: float) -> float:
    """Return the next higher of RATES, or the rate itself."""
    return min((each for each in RATES if each > rate), default=rate)


def slower(rate: float) -> float:
    """Return the next lower of RATES, or the rate itself."""
    return max((each for each in RATES if each < rate), default=rate)
