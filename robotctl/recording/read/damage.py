"""Errors for damaged parts of a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from robotctl.recording.read.read_limits import CURE


class Damaged(Exception):
    """A part of the file cannot be read. The text says what is wrong, without the file name."""


class Unreadable(Damaged):
    """The disk or the memory failed; the same part may be readable later."""


class BeyondLimit(Damaged):
    """Reading on would exceed the limits of `read_limits`. The text says how to raise them."""

    def __init__(self, what: str) -> None:
        """Append to `what` how to raise the limits."""
        super().__init__(f"{what} ({CURE})")


_failures: ContextVar[list[str] | None] = ContextVar("failures", default=None)


@contextmanager
def noted_read_failures() -> Iterator[list[str]]:
    """Yield a list that collects a sentence for each read that fails in this thread in the block.

    Without it, code that continues after such a failure would report damage of the file.
    """
    found: list[str] = []
    token = _failures.set(found)
    try:
        yield found
    finally:
        _failures.reset(token)


def note_read_failure(sentence: str) -> None:
    """Add the sentence to the list of `noted_read_failures`, if a caller uses it."""
    if (found := _failures.get()) is not None:
        found.append(sentence)
