"""The handler that hands log lines to the loop, which publishes them."""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from robotctl.daemon.log.lines import LineHandler, PlainFormatter

CAPACITY: Final = 500
"""Limit on the lines that wait for the loop."""

LINES_PER_TURN: Final = 10
"""Limit on lines published in one turn of the loop: a control tick must not wait for a burst."""

Line = tuple[logging.LogRecord, str]
Publish = Callable[[logging.LogRecord, str], None]
"""Publishes a record with its text, which is safe for a terminal."""


class LoopHandler(LineHandler):
    """Queues records from any thread without blocking; the loop publishes them.

    Lines that do not fit or cannot be published are counted, and a later line reports the count.
    Records that are logged by the publishing itself are ignored: each would cause another one.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, publish: Publish) -> None:
        self._waiting: deque[Line] = deque()
        super().__init__(self._waiting)
        self.setFormatter(PlainFormatter())
        self._loop = loop
        self._publish = publish
        self._failed = 0
        """The number of lines that could not be published; counted in the loop's thread."""
        self._told = 0
        self._is_called = False
        self._publishing_thread: int | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record for the loop, and the notes about repeated records that are due."""
        if threading.get_ident() != self._publishing_thread:
            super().emit(record)

    def prepare(self, record: logging.LogRecord) -> Line:
        """Return the record with its text."""
        return record, self.format(record)

    def enqueue(self, record: Any) -> None:
        """Queue a line, and schedule its publication in the loop.

        Raises:
            queue.Full: The queue has no room for the line.
            RuntimeError: The loop is closed.
        """
        if len(self._waiting) >= CAPACITY:
            raise queue.Full
        self._waiting.append(record)
        if not self._is_called:
            self._is_called = True
            self._loop.call_soon_threadsafe(self._turn)

    def close(self) -> None:
        """Publish the lines that wait; called in the loop's thread."""
        super().close()
        while self._waiting:
            self._publish_some()
        self._tell_missing()

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
        missing = self.lost + self._failed - self._told
        if missing:
            self._told += missing
            text = f"{missing} log lines are missing here: the log file has them"
            name, level = __name__, logging.WARNING
            self._publish_one(logging.LogRecord(name, level, __file__, 0, text, None, None), text)
