"""What the comparison of decided and sent commands counts, and what it finds out of place."""

from __future__ import annotations

from collections import deque

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.rerun.command_bytes import shown_command
from robotctl.rerun.journal_steps import Moments

LATE_NS = NS_PER_S // 2
"""How far the time of a command may lie outside of its step."""

MAX_LATE = 20_000
"""The number of late commands that are kept, the newest ones."""


class CommandCounts:
    """The counts, and which number came first and last since the count began."""

    def __init__(self) -> None:
        self.paired = 0
        self.undecided = 0
        """The number of commands at the end that may have been decided after it."""

        self.missing = 0
        """The number of decided commands without a message, before the last one with a message."""

        self.missing_example = ""
        self.before_first = 0
        """The number of decided commands before the first one with a message."""

        self.late: deque[tuple[int, str]] = deque(maxlen=MAX_LATE)
        """Commands that were sent outside of their step: steady time [ns], and the sentence."""

        self.out_of_order = 0
        """The number of commands after one with a higher number."""

        self.resumed = 0
        """How often the count of a snapshot was not that of the decisions before it."""

        self.unsent = False
        """Whether the journal tells that commands could not be sent."""

        self._first: int | None = None
        self._newest = 0

    @property
    def has_begun(self) -> bool:
        """Whether a command was paired since the count began."""
        return self._first is not None

    def begin_again(self) -> None:
        """Begin the count again: what came before says nothing about what follows."""
        self._first = None

    def is_passed(self, number: int) -> bool:
        """Return whether a later number, or this one, was paired."""
        return self._first is not None and not follows(number, self._newest)

    def pair(self, sequence: int, moments: Moments, publish_ns: int) -> None:
        """Count a command that was sent as it was decided."""
        self.paired += 1
        if self._first is None:
            self._first = self._newest = sequence
        elif follows(sequence, self._newest):
            self._newest = sequence
        else:
            self.out_of_order += 1
        steady_ns, begin_ns, end_ns = moments
        if end_ns and not begin_ns - LATE_NS <= publish_ns <= end_ns + LATE_NS:
            off_s = max(begin_ns - publish_ns, publish_ns - end_ns) / NS_PER_S
            when = "before" if publish_ns < begin_ns else "after"
            self.late.append((steady_ns, f"command {sequence}, {off_s:.3f} s {when} its decision"))

    def lack(self, number: int, numbers: bytes) -> None:
        """Count a decided command without a message; `numbers` is its velocity."""
        if self._first is not None and follows(self._first, number):
            self.before_first += 1
            return
        self.missing += 1
        if not self.missing_example:
            self.missing_example = f"command {number} ({shown_command(numbers)})"


def follows(number: int, other: int) -> bool:
    """Return whether a number is later than another one; they begin again after MAX_SEQUENCE."""
    return 0 < (number - other) & MAX_SEQUENCE <= MAX_SEQUENCE // 2
