"""Velocity commands that robotctl did not decide: another publisher explains some of them."""

from __future__ import annotations

from collections import deque

from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.command_bytes import shown_command

NEAR_NS = 5 * NS_PER_S
"""How long before or after it was noticed another publisher may have sent a command."""


class OtherCommands:
    """The commands without a decision, by whether another publisher was there at that time.

    Times are those of the journal (steady, in nanoseconds).
    """

    def __init__(self) -> None:
        self.extra = 0
        """The number of messages without a known sender."""

        self.extra_example = ""
        self.foreign = 0
        """The number of messages of other publishers."""

        self.foreign_example = ""
        self.after_end = 0
        """The number of messages after the end of a journal that the recording outlives."""

        self._heard_ns: int | None = None
        self._publish = False
        self._waiting: deque[tuple[int, bytes]] = deque()
        """Messages whose sender may still be noticed: time, numbers."""

    @property
    def are_waiting(self) -> bool:
        """Whether there are messages whose sender may still be noticed."""
        return bool(self._waiting)

    def hear(self, t_ns: int) -> None:
        """Note that another publisher was noticed."""
        self._heard_ns = t_ns
        while self._waiting:
            at_ns, numbers = self._waiting.popleft()
            if t_ns - at_ns <= NEAR_NS:
                self._note_foreign(numbers)
            else:
                self._note_extra(numbers)

    def publish(self, t_ns: int, others: bool) -> None:
        """Note whether the graph shows other publishers from now on."""
        if others or self._publish:
            self.hear(t_ns)
        self._publish = others

    def doubt(self, t_ns: int, numbers: bytes) -> None:
        """Take a command that was not decided."""
        heard = self._publish or (self._heard_ns is not None and t_ns - self._heard_ns <= NEAR_NS)
        if heard:
            self._note_foreign(numbers)
        else:
            self._waiting.append((t_ns, numbers))

    def settle(self, t_ns: int) -> None:
        """Count messages as extra that are older than `NEAR_NS`: no other publisher was noticed."""
        while self._waiting and t_ns - self._waiting[0][0] > NEAR_NS:
            self._note_extra(self._waiting.popleft()[1])

    def end(self, end_ns: float) -> None:
        """Give up everything that is left; what came from `end_ns` on is after the journal."""
        for t_ns, numbers in self._waiting:
            if t_ns < end_ns:
                self._note_extra(numbers)
            else:
                self.after_end += 1
        self._waiting.clear()

    def _note_extra(self, numbers: bytes) -> None:
        self.extra += 1
        self.extra_example = self.extra_example or shown_command(numbers)

    def _note_foreign(self, numbers: bytes) -> None:
        self.foreign += 1
        self.foreign_example = self.foreign_example or shown_command(numbers)
