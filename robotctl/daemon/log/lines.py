"""The daemon's log: lines that a terminal can be shown, written without holding up the loop."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from robotctl.daemon.log.queue import StderrQueue
from robotctl.daemon.log.repeats import Repeats
from robotctl.printable import printable, without_colours


class PlainFormatter(logging.Formatter):
    """Names that others chose neither steer a terminal nor look like an entry of their own."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's own name
        """Return the message, colours left out, control characters escaped, lines indented."""
        lines = without_colours(super().formatMessage(record)).split("\n")
        return "\n    ".join(printable(line) for line in lines)


class QueueHandler(logging.Handler):
    """Hands each record to the queue and never waits; what repeats itself is counted instead."""

    def __init__(self, queue: StderrQueue) -> None:
        super().__init__()
        self._queue = queue
        self._repeats = Repeats()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the record's lines, and what is due to be said about repeated ones."""
        try:
            for due in self._repeats.admit(record):
                self._queue.put(self.format(due))
        except Exception:  # noqa: BLE001 - without memory for a line, it is counted
            self._queue.count_lost()

    def close(self) -> None:
        """Say how often the last lines were repeated."""
        for due in self._repeats.end():
            self._queue.put(self.format(due))
        super().close()


@contextmanager
def log_to_stderr() -> Iterator[None]:
    """Log to stderr within the block; at its end what is queued is written, within 1 s."""
    with StderrQueue() as queue:
        handler = QueueHandler(queue)
        handler.setFormatter(PlainFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        root = logging.getLogger()
        root.addHandler(handler)
        root.setLevel(logging.INFO)
        logging.captureWarnings(True)
        try:
            yield
        finally:
            logging.captureWarnings(False)
            root.removeHandler(handler)
            handler.close()
