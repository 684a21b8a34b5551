"""Finds what explains the commands at the end of a recording whose decisions are not in it.

A watchdog sends zeros while the control loop stalls, and the journal tells of them afterwards. A
daemon that fails sends its last zeros without a decision. A recording may end before its journal
tells either.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.records import MAX_SEQUENCE
from robotctl.rerun.command_bytes import STILL

LAST_ZEROS: Final = 2
"""How many zeros a daemon that fails while it moves the robot may send after its kernel's last
command."""

ZERO_PERIOD_NS: Final = NS_PER_S // 25
"""The watchdog sends its zeros less often than this: one in 50 ms."""

STALL_NS: Final = 10 * NS_PER_S
"""The longest stall that may end together with the recording."""

JOURNAL_LAG_NS: Final = NS_PER_S
"""How far a journal that a recorder only receives may lag behind the commands."""


class Early(NamedTuple):
    """A message before its decision: its six numbers, publish time and journal time [ns]."""

    numbers: bytes
    publish_ns: int
    t_ns: int


class UndecidedEnd(NamedTuple):
    """The end of a journal: the number of its last command, and when it ends [ns since the epoch].

    The next `cut` commands may be decided after the end. A journal that `is_own` was written by the
    recorder itself; one that `is_closed` ends with the number of all commands.
    """

    number: int
    log_ns: int
    cut: int
    is_own: bool
    is_closed: bool

    def unexplained(self, early: Mapping[int, Sequence[Early]]) -> Iterator[Early]:
        """Yield the messages that neither a stall nor a failure at the end explains, by number."""
        for sequence, messages in early.items():
            later = (sequence - self.number) & MAX_SEQUENCE
            explained = next((each for each in messages if self._explains(each, later)), None)
            yield from _without(messages, explained)

    def _explains(self, message: Early, later: int) -> bool:
        """Return whether the end explains a message, `later` numbers after the last command."""
        if later <= self.cut:
            return True
        after_ns = message.publish_ns - self.log_ns
        if not self.is_own:
            return after_ns > -JOURNAL_LAG_NS
        return message.numbers == STILL and (
            later <= LAST_ZEROS or (later - LAST_ZEROS) * ZERO_PERIOD_NS <= after_ns <= STALL_NS
        )


def _without(messages: Iterable[Early], explained: Early | None) -> Iterator[Early]:
    return (each for each in messages if each is not explained)
