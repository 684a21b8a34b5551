"""What is wrong with the bytes of a file, and where."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

MAX_FLAWS: Final = 20
"""Maximum number of flaws that are kept of a file; further ones are counted."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """A part of a file that is not as it was written: the bytes from `start` to `end`.

    `end` is the offset after the last byte. `text` says what is wrong, without place and file name.
    """

    start: int
    end: int
    text: str

    def sentence(self) -> str:
        """Return place and text as one sentence."""
        return f"bytes {self.start} to {self.end}: {self.text}"


@dataclass(slots=True)
class Flaws:
    """The flaws of one file, the first ones in their order, and how many there are."""

    kept: list[Flaw] = field(default_factory=list)
    count: int = 0

    def add(self, start: int, end: int, text: str) -> None:
        """Add a flaw."""
        self.count += 1
        if len(self.kept) < MAX_FLAWS:
            self.kept.append(Flaw(start, end, text))
