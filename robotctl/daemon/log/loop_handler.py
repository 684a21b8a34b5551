"""The handler that hands log lines to the loop, which publishes them."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Final

from robotctl.daemon.log.lines import PlainFormatter
from robotctl.daemon.log.repeats import Repeats

CAPACITY: Final = 500
"""Lines that may wait for the loop."""

LINES_PER_TURN: Final = 10
"""Lines that are published in one turn of the loop: a control tick must not wait for a burst."""

Publish = Callable[[logging.LogRecord, str], None]
"""Publishes a record with its text, which is safe for a terminal."""


class LoopHandler(logging.Handler):
    """A handler for records of any thread; none of them waits, and the loop publishes them.

    Equal warnings are counted as in the log. Lines that do not fit or cannot be published are
    counted, and a line says how many are missing. What is logged while a line is published is left
    out, so that no line leads to the next.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, publish: Publish) -> None:
        super().__init__()
        self.setFormatter(PlainFormatter())
        self._loop = loop
        self._publish = publish
        self._repeats = Repeats()
        self._waiting: deque[tuple[logging.LogRecord, str]] = deque()
        self._dropped = 0
        """Lines that did not fit; counted under the handler's lock."""
        self._failed = 0
        """Lines that could not be published; counted in the loop."""
        self._told = 0
        self._is_called = False
        self._publishing_thread: int | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record for the loop, and the notes about repeated records that are due."""
        if threading.get_ident() == self._publishing_thread:
            return
        try:
            for due in self._repeats.admit(record):
                self._put(due)
        except Exception:  # noqa: BLE001 - no memory for a line, or no loop any more
            self._dropped += 1

    def close(self) -> None:
        """Publish what waits; called in the loop."""
        for due in self._repeats.end():
            self._put(due)
        while self._waiting:
            self._publish_some()
        self._tell_missing()
        super().close()

    def _put(self, record: logging.LogRecord) -> None:
        if len(self._waiting) >= CAPACITY:
            self._dropped += 1
            return
        self._waiting.append((record, self.format(record)))
        if not self._is_called:
            self._is_called = True
            self._loop.call_soon_threadsafe(self._turn)

    def _turn(self) -> None:
        self._is_called = False  # before the queue is read: a line may come in between
        self._publish_some()
        if not self._waiting:
            self._tell_missing()
        elif not self._is_called:
            self._is_called = True
            self._loop.call_soon(self._turn)

    def _publish_some(self) -> None:
        for _ in range(min(LINES_PER_TURN, len(self._waiting))):
            self._publish_one(*self._waiting.popleft())

    def _publish_one(self, record: logging.LogRecord, text: str) -> None:
        self._publishing_thread = threading.get_ident()
        try:
            self._publish(record, text)
        except Exception:  # noqa: BLE001 - a log line must not end the loop
            self._failed += 1
        finally:
            self._publishing_thread = None

    def _tell_missing(self) -> None:
        missing = self._dropped + self._failed - self._told
        if missing:
            self._told += missing
            text = f"{missing} log lines are missing here: the log file has them"
            name, level = __name__, logging.WARNING
            self._publish_one(logging.LogRecord(name, level, __file__, 0, text, None, None), text)
