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
        """Keep the sentence without the cure."""
        super().__init__(f"{what} ({CURE})")


_failures: ContextVar[list[str] | None] = ContextVar("failures", default=None)


@contextmanager
def noted_read_failures() -> Iterator[list[str]]:
    """Yield the sentences of the reads that fail in this thread while the block runs.

    A reader that goes on after such a failure takes it for damage.
    """
    found: list[str] = []
    token = _failures.set(found)
    try:
        yield found
    finally:
        _failures.reset(token)


def note_read_failure(sentence: str) -> None:
    """Note a read that failed, if a caller wants to know."""
    if (found := _failures.get()) is not None:
        found.append(sentence)
