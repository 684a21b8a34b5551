"""Log lines: their format, a filter for repeated ones, and queues for stderr and for the loop."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import os
import queue
import select
import stat
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from logging.handlers import QueueHandler, QueueListener
from typing import Any, Final

from robotctl.base.text import printable, without_colours

CAPACITY_BYTES: Final = 1024 * 1024
"""Size of the queue for stderr, the largest pipe of Linux (/proc/sys/fs/pipe-max-size)."""

FLUSH_S: Final = 1.0
"""Limit on the wait for the queue for stderr at the end."""

WINDOW_S: Final = 10.0
"""Length of a burst of equal lines, counted from its first line."""

WRITTEN: Final = 3
"""How many lines of a burst are written."""

MAX_REMEMBERED: Final = 200
"""Limit on the bursts that are remembered."""

_FORMAT: Final = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_STDERR: Final = 2
_READ_BYTES: Final = 65536
_END: Final = b"\0"


class PlainFormatter(logging.Formatter):
    """A formatter whose output can neither control a terminal nor contain a forged log line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's own name
        """Return the text without colours and control characters, with indented extra lines."""
        lines = without_colours(super().formatMessage(record)).split("\n")
        return "\n    ".join(printable(line) for line in lines)


@dataclass(slots=True)
class _Burst:
    record: logging.LogRecord
    text: str
    begun: float
    count: int = 1


class Repeats:
    """Passes a warning or error at most WRITTEN times in WINDOW_S, and all lower levels always."""

    def __init__(self) -> None:
        self._bursts: dict[tuple[str, int, str, str], _Burst] = {}

    def admit(self, record: logging.LogRecord) -> Iterator[logging.LogRecord]:
        """Yield a note on each burst that is over, then `record` unless it repeats too often."""
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
        """Yield a note for each burst with lines left out, and forget all bursts."""
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
    """Yield a note with the number of the burst's lines left out, if any."""
    left_out = burst.count - WRITTEN
    if left_out > 0:
        record = burst.record
        text = f"repeated {left_out} times more: {burst.text}"
        yield logging.LogRecord(record.name, record.levelno, "", 0, "%s", (text,), None)


class LineHandler(QueueHandler):
    """Queues lines without blocking, and counts lines that repeat often or do not fit."""

    def __init__(self, lines: Any = None) -> None:
        super().__init__(lines)
        self.lost = 0
        """Lines that could not be queued, counted under the handler's lock."""
        self._repeats = Repeats()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the record, and the notes about repeated records that are due."""
        self._queue(self._repeats.admit(record))

    def close(self) -> None:
        """Queue the notes about repeated records that are not queued yet, and close the handler."""
        self._queue(self._repeats.end())
        super().close()

    def _queue(self, records: Iterator[logging.LogRecord]) -> None:
        try:
            for record in records:
                self.enqueue(self.prepare(record))
        except Exception:  # noqa: BLE001 - no room or no memory for a line; logging would print
            self.lost += 1


class _StderrListener(QueueListener):
    """Writes lines to stderr in a thread, from a pipe that does not block its writers."""

    def __init__(self) -> None:
        self.untaken = 0
        """The number of lines that could not be written to stderr."""
        self._is_ending = False
        self._stderr = fcntl.fcntl(_STDERR, fcntl.F_DUPFD_CLOEXEC, _STDERR + 1)
        self._reading, self.writing = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self.writing, False)
        with suppress(OSError):  # the user's limit of pipe memory is reached: it stays small
            fcntl.fcntl(self.writing, fcntl.F_SETPIPE_SZ, CAPACITY_BYTES)
        # C libraries write to a regular file directly: their last words before an abort are kept.
        if not stat.S_ISREG(os.fstat(_STDERR).st_mode):
            os.dup2(self.writing, _STDERR)
        no_queue: Any = None
        super().__init__(no_queue)

    def dequeue(self, block: bool) -> Any:
        """Return data from the pipe. At the pipe's end, write the last data and return None."""
        data = os.read(self._reading, _READ_BYTES)
        if not (self._is_ending and _END in data):
            return data
        self.handle(data.replace(_END, b""))
        return None

    def handle(self, record: Any) -> None:
        """Write lines to stderr, and wait while stderr blocks."""
        rest = memoryview(record)
        while rest:
            try:
                rest = rest[os.write(self._stderr, rest) :]
            except BlockingIOError:  # another process made the shared terminal non-blocking
                poll = select.poll()
                poll.register(self._stderr, select.POLLOUT)
                poll.poll()
            except OSError:  # no space left, or no reader
                self.untaken += bytes(rest).count(b"\n")
                return

    def stop(self) -> None:
        """Write the lines and restore stderr, or drop all output after FLUSH_S."""
        self._is_ending = True
        with suppress(BlockingIOError):
            os.write(self.writing, _END)  # fd 2 keeps the pipe open, so there is no end of file
        thread = self._thread
        assert thread is not None
        thread.join(FLUSH_S)  # not forever
        if thread.is_alive():
            os.dup2(os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC), _STDERR)
            return
        os.dup2(self._stderr, _STDERR)
        for descriptor in (self._stderr, self._reading, self.writing):
            os.close(descriptor)


class _StderrHandler(LineHandler):
    """Writes lines to a listener's pipe, with a note on lost lines after a loss."""

    def __init__(self, listener: _StderrListener, line: str) -> None:
        super().__init__()
        self.setFormatter(PlainFormatter(line))
        self._listener = listener
        self._told = 0
        self._is_torn = False

    def prepare(self, record: logging.LogRecord) -> str:
        return f"{self.format(record)}\n"

    def enqueue(self, record: Any) -> None:
        """Queue a line, or raise BlockingIOError if the pipe has no room."""
        untold = self._untold()
        note = f"log: {untold} lines are missing here, stderr did not take them\n" if untold else ""
        data = f"{chr(10) * self._is_torn}{note}{record}".encode(errors="backslashreplace")
        written = os.write(self._listener.writing, data)
        self._told += untold
        self._is_torn = written < len(data)
        self.lost += self._is_torn

    def close(self) -> None:
        super().close()
        if self._untold():
            with suppress(BlockingIOError):
                self.enqueue("")

    def _untold(self) -> int:
        return self.lost + self._listener.untaken - self._told


@contextmanager
def log_to_stderr(line: str = _FORMAT) -> Iterator[None]:
    """Log to stderr within the block, in the format `line`. The end takes at most FLUSH_S."""
    listener = _StderrListener()
    handler = _StderrHandler(listener, line)
    listener.start()
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
        listener.stop()


CAPACITY: Final = 500
"""Limit on the lines that wait for the loop."""

LINES_PER_TURN: Final = 10
"""Limit on lines published in one turn of the loop, as a control tick must not wait for a burst."""

Line = tuple[logging.LogRecord, str]
Publish = Callable[[logging.LogRecord, str], None]
"""Publishes a record with its text."""


class LoopHandler(LineHandler):
    """Queues log records of all threads without blocking, and publishes them in the loop.

    A later line reports the number of lost lines. Records that `publish` logs are ignored.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, publish: Publish) -> None:
        self._waiting: deque[Line] = deque()
        super().__init__(self._waiting)
        self.setFormatter(PlainFormatter())
        self._loop = loop
        self._publish = publish
        self._failed = 0
        """The number of lines that could not be published."""
        self._told = 0
        self._is_called = False
        self._publishing_thread: int | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record for the loop, and the notes about repeated records that are due."""
        if threading.get_ident() != self._publishing_thread:
            super().emit(record)

    def prepare(self, record: logging.LogRecord) -> Line:
        """Return `record` with its formatted text."""
        return record, self.format(record)

    def enqueue(self, record: Any) -> None:
        """Queue a line for the loop, or raise queue.Full."""
        if len(self._waiting) >= CAPACITY:
            raise queue.Full
        self._waiting.append(record)
        if not self._is_called:
            self._is_called = True
            self._loop.call_soon_threadsafe(self._turn)

    def close(self) -> None:
        """Publish the waiting lines, in the loop's thread."""
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
