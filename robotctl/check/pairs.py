"""Holds both sides of a comparison by number until all that may explain a difference is known.

A message and its journal entry reach a recording in either order, and what explains a difference, a
stall or another publisher, may be recorded seconds later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

from robotctl.kernel.units import NS_PER_S

WAIT_NS: Final = 30 * NS_PER_S
"""How long both sides wait for each other, on the steady clock of the journal."""

MAX_WAITING: Final = 20_000
"""The number of numbers that wait; if there are more, the oldest one is judged at once."""

Entry = TypeVar("Entry")
Sent = TypeVar("Sent")


@dataclass(slots=True)
class Slot(Generic[Entry, Sent]):
    """What has one number: journal entries and messages. Two publishers may use one number."""

    since_ns: int
    entries: list[Entry] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)


class Waiting(Generic[Entry, Sent]):
    """The slots that are not judged yet, the oldest first."""

    def __init__(self, judge: Callable[[int, Slot[Entry, Sent]], None]) -> None:
        """`judge` gets each slot with its number, when nothing more is to be expected."""
        self._judge = judge
        self._slots: dict[int, Slot[Entry, Sent]] = {}

    def slot(self, number: int, t_ns: int) -> Slot[Entry, Sent]:
        """Return the slot of a number; `t_ns` is the time of the journal, for a new one."""
        slot = self._slots.get(number)
        if slot is None:
            slot = self._slots[number] = Slot(t_ns)
            if len(self._slots) > MAX_WAITING:
                self._judge(*self._oldest())
        return slot

    def settle(self, t_ns: int) -> None:
        """Judge the slots that have waited long enough at `t_ns`."""
        while self._slots and t_ns - next(iter(self._slots.values())).since_ns > WAIT_NS:
            self._judge(*self._oldest())

    def rest(self) -> Iterator[tuple[int, Slot[Entry, Sent]]]:
        """Remove and yield all slots, at the end or where journal entries are missing."""
        while self._slots:
            yield self._oldest()

    def _oldest(self) -> tuple[int, Slot[Entry, Sent]]:
        number = next(iter(self._slots))
        return number, self._slots.pop(number)
