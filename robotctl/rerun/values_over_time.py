"""The values that something had over time, for comparison with what was shown at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.journal_steps import Moments

EDGE_NS: Final = NS_PER_S // 200
"""How near to the begin of a step either value may be shown: two clocks are compared."""

MAX_CHANGES: Final = 10_000
"""The number of changes that are kept."""

Value = TypeVar("Value")


@dataclass(slots=True)
class TimedChange(Generic[Value]):
    """A change to a value: its step, and whether the value was shown within it."""

    value: Value
    moments: Moments
    is_shown: bool = False


class Timeline(Generic[Value]):
    """The changes of a value in the order of time; questions must come in that order, too."""

    def __init__(self, value: Value) -> None:
        self._value = value
        self._last = value
        self._changes: deque[TimedChange[Value]] = deque(maxlen=MAX_CHANGES)

    def change(self, value: Value, moments: Moments) -> None:
        """Take the value after a step; nothing happens if it is the one before it."""
        if value != self._last:
            self._last = value
            self._changes.append(TimedChange(value, moments))

    def shows(self, value: Value, at_ns: int) -> bool:
        """Return whether a value was right at a time since the epoch; note that it was shown."""
        is_right, step = value == self._value, None
        for change in self._changes:
            begin_ns = change.moments[1]
            if begin_ns - EDGE_NS > at_ns:
                break
            if change.value == value:
                change.is_shown = is_right = True
                step = change.moments
            elif begin_ns + EDGE_NS < at_ns and change.moments != step:
                is_right = False
        return is_right

    def forget(self, until_ns: float) -> Iterator[TimedChange[Value]]:
        """Remove and yield the changes whose steps ended before a time since the epoch."""
        while self._changes and self._changes[0].moments[2] + EDGE_NS < until_ns:
            change = self._changes.popleft()
            self._value = change.value
            yield change
