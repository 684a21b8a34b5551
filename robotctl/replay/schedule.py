"""Which recorded moment is due when: a straight line, until somebody pauses or changes the rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

from robotctl.replay.job import MAX_RATE, MIN_RATE

_STEPS: Final = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""The rates that keys choose, in each power of ten."""

RATES: Final = tuple(
    round(step * 10.0**power, 4)
    for power in range(-3, 5)
    for step in _STEPS
    if MIN_RATE <= round(step * 10.0**power, 4) <= MAX_RATE
)


@dataclass(frozen=True, slots=True)
class Schedule:
    """`at_ns` of recorded time is due at `moment_ns` of the steady clock, later times by `rate`.

    A rate of None is as fast as possible: everything is due. Nothing is while `paused`.
    """

    moment_ns: int
    at_ns: int
    rate: float | None
    paused: bool = False

    def due_ns(self, at_ns: int) -> int:
        """When a recorded moment is due, were nothing changed."""
        if self.rate is None:
            return self.moment_ns
        return self.moment_ns + round((at_ns - self.at_ns) / self.rate)

    def position_ns(self, now_ns: int) -> int:
        """The recorded moment that is due now."""
        if self.paused or self.rate is None:
            return self.at_ns
        return self.at_ns + max(round((now_ns - self.moment_ns) * self.rate), 0)

    def pause(self, now_ns: int) -> Self:
        """The schedule that stands still from now on."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), paused=True)

    def resume(self, now_ns: int) -> Self:
        """The schedule that goes on from where it is."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), paused=False)

    def with_rate(self, now_ns: int, rate: float) -> Self:
        """The schedule that goes on at another rate."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), rate=rate)


def faster(rate: float) -> float:
    """The next higher of RATES, or the rate itself."""
    return min((each for each in RATES if each > rate), default=rate)


def slower(rate: float) -> float:
    """The next lower of RATES, or the rate itself."""
    return max((each for each in RATES if each < rate), default=rate)
