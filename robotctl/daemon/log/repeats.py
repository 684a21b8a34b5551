"""Warnings and errors that repeat themselves: a few are written, the others are counted."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

WINDOW_S = 10.0
"""How long equal lines count as one burst, from the first of them."""

WRITTEN = 3
"""Equal lines of one burst that are written; a fault that lasts must not fill the disk."""

MAX_REMEMBERED = 200
"""Lines that are compared with; of more different ones in one window, the oldest is forgotten."""


@dataclass(slots=True)
class _Burst:
    record: logging.LogRecord
    text: str
    begun: float
    count: int = 1


class Repeats:
    """Decides which records are written. Equal means: same logger, level, text and exception.

    What is less than a warning tells what was done, and is written each time.
    """

    def __init__(self) -> None:
        self._bursts: dict[tuple[str, int, str, str], _Burst] = {}

    def admit(self, record: logging.LogRecord) -> Iterator[logging.LogRecord]:
        """Yield what is to be written now: notes about bursts that are over, then the record."""
        yield from self._over(record.created)
        if record.levelno < logging.WARNING:
            yield record
            return
        text, error = record.getMessage(), record.exc_info
        key = (record.name, record.levelno, text, repr(error[1]) if error else "")
        burst = self._bursts.get(key)
        if burst is None:
            if len(self._bursts) >= MAX_REMEMBERED:
                yield from _note(self._bursts.pop(next(iter(self._bursts))))
            self._bursts[key] = _Burst(record, text, record.created)
            yield record
        else:
            burst.count += 1
            if burst.count <= WRITTEN:
                yield record

    def end(self) -> Iterator[logging.LogRecord]:
        """Yield the notes about all bursts."""
        for burst in self._bursts.values():
            yield from _note(burst)
        self._bursts.clear()

    def _over(self, now: float) -> Iterator[logging.LogRecord]:
        while self._bursts:
            key, burst = next(iter(self._bursts.items()))  # the oldest
            if 0.0 <= now - burst.begun < WINDOW_S:
                return
            del self._bursts[key]
            yield from _note(burst)


def _note(burst: _Burst) -> Iterator[logging.LogRecord]:
    """How often a line was left out, without its traceback."""
    left_out = burst.count - WRITTEN
    if left_out > 0:
        record = burst.record
        text = f"repeated {left_out} times more: {burst.text}"
        yield logging.LogRecord(record.name, record.levelno, "", 0, "%s", (text,), None)
