"""How late messages were: quantiles of any number of values in constant memory."""

from __future__ import annotations

from array import array
from typing import Final

_SUB_BITS: Final = 5
"""32 steps per power of two: a quantile is at most 3 % too high."""

_LARGEST: Final = (1 << 62) - 1


class Lateness:
    """A histogram of nanoseconds; its steps grow with the value."""

    __slots__ = ("_counts", "count", "max_ns")

    def __init__(self) -> None:
        self._counts = array("Q", bytes(8 * (_step(_LARGEST) + 1)))
        self.count = 0
        self.max_ns = 0

    def add(self, late_ns: int) -> None:
        """Add one value; a negative one counts as 0."""
        late_ns = min(max(late_ns, 0), _LARGEST)
        self._counts[_step(late_ns)] += 1
        self.count += 1
        if late_ns > self.max_ns:
            self.max_ns = late_ns

    def quantile_us(self, share: float) -> float:
        """Return the quantile for `share` (0..1) [us]; 0 without values."""
        rank = share * self.count
        seen = 0
        for step, count in enumerate(self._counts):
            seen += count
            if count and seen >= rank:
                return min(_highest(step), self.max_ns) / 1e3
        return 0.0


def _step(value: int) -> int:
    shift = max(value.bit_length() - _SUB_BITS - 1, 0)
    return (shift << _SUB_BITS) + (value >> shift)


def _highest(step: int) -> int:
    """Return the largest value of a step."""
    shift = max((step >> _SUB_BITS) - 1, 0)
    return ((step - (shift << _SUB_BITS) + 1) << shift) - 1
