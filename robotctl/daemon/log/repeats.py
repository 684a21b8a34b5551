"""Repeated warnings and errors: the first few are written, the others counted."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

WINDOW_S = 10.0
"""Length of a burst of equal lines, from the first of them."""

WRITTEN = 3
"""Equal lines of a burst that are written; a lasting fault must not fill the disk."""

MAX_REMEMBERED = 200
"""Different lines that are remembered; a further one replaces the oldest."""


@dataclass(slots=True)
class _Burst:
    record: logging.LogRecord
    text: str
    begun: float
    count: int = 1


class Repeats:
    """A filter for repeated records. Equal records have the same logger, level, text, exception.

    Records below the level of a warning are always written.
    """

    def __init__(self) -> None:
        self._bursts: dict[tuple[str, int, str, str], _Burst] = {}

    def admit(self, record: logging.LogRecord) -> Iterator[logging.LogRecord]:
        """Yield the records to write now: notes about finished bursts, then the record itself."""
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
    """Yield a note with the number of lines left out, if there were any."""
    left_out = burst.count - WRITTEN
    if left_out > 0:
        record = burst.record
        text = f"repeated {left_out} times more: {burst.text}"
        yield logging.LogRecord(record.name, record.levelno, "", 0, "%s", (text,), None)
