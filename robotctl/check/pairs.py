"""Holds both sides of a comparison by number until all that may explain a difference is known.

A message and its journal entry reach a recording in either order, and what explains a difference, a
stall or another publisher, may be recorded seconds later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

MAX_WAITING: Final = 20_000
"""How many numbers wait, several minutes of a topic; if there are more, the oldest is judged."""

Entry = TypeVar("Entry")
Sent = TypeVar("Sent")


@dataclass(slots=True)
class Slot(Generic[Entry, Sent]):
    """The journal entries and the messages with the same number; publishers may share numbers."""

    entries: list[Entry] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)


class Waiting(Generic[Entry, Sent]):
    """The slots, one per number, that are not judged yet; the oldest first."""

    def __init__(self, judge: Callable[[int, Slot[Entry, Sent]], None]) -> None:
        """`judge` gets each slot with its number, when nothing more is to be expected."""
        self._judge = judge
        self._slots: dict[int, Slot[Entry, Sent]] = {}

    def slot(self, number: int) -> Slot[Entry, Sent]:
        """Return the slot of a number, which is the youngest from now on."""
        slot = self._slots.pop(number, None) or Slot()
        self._slots[number] = slot
        if len(self._slots) > MAX_WAITING:
            self._judge(*self._oldest())
        return slot

    def drop(self, number: int) -> None:
        """Remove the slot of a number, which needs no judgement any more."""
        self._slots.pop(number, None)

    def clear(self) -> None:
        """Remove all slots."""
        self._slots.clear()

    def rest(self) -> Iterator[tuple[int, Slot[Entry, Sent]]]:
        """Remove and yield all slots, at the end or where journal entries are missing."""
        while self._slots:
            yield self._oldest()

    def _oldest(self) -> tuple[int, Slot[Entry, Sent]]:
        number = next(iter(self._slots))
        return number, self._slots.pop(number)
