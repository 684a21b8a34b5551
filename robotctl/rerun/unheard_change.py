"""Finds messages that the control loop must have received, but that are not in the journal.

The control loop hands on each value that differs from the last one, and equal ones from time to
time. It receives inputs with best effort, so some may be lost, but not all for a longer time.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from robotctl.kernel.units import NS_PER_S

PATIENCE_NS = NS_PER_S // 2
"""How long messages may go unheard; a stall of the control loop adds its time."""

GAP_NS = NS_PER_S // 10
"""The longest gap between two messages that is counted; a longer gap holds no message to miss."""

BEGIN_NS = 3 * NS_PER_S
"""How long messages may be missed at the beginning, before the control loop is connected."""

MAX_WAITING = 100_000
"""The number of messages, and of inputs, that may wait; older ones are not compared."""


class ShownValue(NamedTuple):
    """A message: its number, its value as text (nan differs from itself), when it was recorded."""

    sequence: int
    value: str
    log_ns: int


class UnheardChange:
    """The comparison of one publisher's messages with what was heard of it, in its own order."""

    def __init__(self, repeat_ns: int) -> None:
        """`repeat_ns`: after this time an equal value becomes an event, too."""
        self.example = ""
        """The first messages that must have been heard and were not, "" if there are none."""

        self._repeat_ns = repeat_ns
        self._waiting: deque[ShownValue] = deque(maxlen=MAX_WAITING)
        self._heard: set[int] = set()
        self._last: ShownValue | None = None
        """The last message that was heard, the first of all before that."""

        self._is_begin = True
        self._since: ShownValue | None = None
        self._before_ns = self._unheard_ns = 0

    def message(self, shown: ShownValue) -> None:
        """Take a message."""
        self._waiting.append(shown)

    def heard(self, sequence: int) -> None:
        """Take an input of the journal, with the number of its message."""
        self._heard.add(sequence)

    def forget(self) -> None:
        """Begin again: journal entries are missing."""
        self._waiting.clear()
        self._heard.clear()
        self._last = self._since = None
        self._is_begin = True

    def settle(self, stall_ns: int) -> None:
        """Compare the messages up to the last one that was heard, after stalls of `stall_ns`."""
        newest = max(self._heard, default=0)
        while self._waiting and self._waiting[0].sequence <= newest:
            self._take(self._waiting.popleft(), stall_ns)
        if len(self._heard) > MAX_WAITING:
            self._heard.clear()

    def end(self, log_ns: int, stall_ns: int) -> None:
        """Compare the messages up to the end of the journal."""
        self.settle(stall_ns)
        for shown in self._waiting:
            if shown.log_ns <= log_ns:
                self._take(shown, stall_ns)

    def _take(self, shown: ShownValue, stall_ns: int) -> None:
        if shown.sequence in self._heard:
            self._heard.discard(shown.sequence)
            self._last, self._since, self._is_begin = shown, None, False
            return
        last = self._last = self._last or shown
        if shown.value == last.value and shown.log_ns - last.log_ns < self._repeat_ns:
            self._since = None
        elif self._since is None:
            self._since, self._unheard_ns = shown, 0
        else:
            self._unheard_ns += min(shown.log_ns - self._before_ns, GAP_NS)
            patience_ns = stall_ns + (BEGIN_NS if self._is_begin else PATIENCE_NS)
            if self._unheard_ns > patience_ns and not self.example:
                self.example = f"messages {self._since.sequence} to {shown.sequence}"
        self._before_ns = shown.log_ns
