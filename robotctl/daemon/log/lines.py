"""The format of log lines, and the handler that queues them without blocking the loop."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from robotctl.daemon.log.queue import StderrQueue
from robotctl.daemon.log.repeats import Repeats
from robotctl.printable import printable, without_colours


class PlainFormatter(logging.Formatter):
    """A formatter: foreign text can neither control a terminal nor imitate a log line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's own name
        """Return the message without colours, control characters escaped, extra lines indented."""
        lines = without_colours(super().formatMessage(record)).split("\n")
        return "\n    ".join(printable(line) for line in lines)


class QueueHandler(logging.Handler):
    """A handler that queues records without waiting, and counts repeated ones instead."""

    def __init__(self, queue: StderrQueue) -> None:
        super().__init__()
        self._queue = queue
        self._repeats = Repeats()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the record's lines, and the notes about repeated records that are due."""
        try:
            for due in self._repeats.admit(record):
                self._queue.put(self.format(due))
        except Exception:  # noqa: BLE001 - no memory for a line: count it
            self._queue.count_lost()

    def close(self) -> None:
        """Queue the notes about the last repeated records."""
        for due in self._repeats.end():
            self._queue.put(self.format(due))
        super().close()


_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


@contextmanager
def log_to_stderr(line: str = _FORMAT) -> Iterator[None]:
    """Log to stderr within the block; at its end, write the queue for at most 1 s.

    `line` is the format of a line, as for `logging.Formatter`.
    """
    with StderrQueue() as queue:
        handler = QueueHandler(queue)
        handler.setFormatter(PlainFormatter(line))
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
