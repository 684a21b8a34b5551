"""Reads that failed because of the disk or the memory: they tell nothing about the recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

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
