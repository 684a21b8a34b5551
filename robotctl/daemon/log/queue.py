"""A bounded queue in front of stderr, and the thread that empties it.

The reader of stderr may stop: a terminal after Ctrl-S, a full pipe, a disk that hangs. The queue is
a pipe, and a write to it never waits.
"""

from __future__ import annotations

import fcntl
import os
import select
import stat
import threading
from contextlib import suppress
from typing import Self

CAPACITY_BYTES = 1024 * 1024
"""Size of the queue: the largest pipe that Linux grants (/proc/sys/fs/pipe-max-size)."""

FLUSH_S = 1.0
"""How long the end waits until the queue is written."""

_STDERR = 2
_READ_BYTES = 65536
_END = b"\0"


class StderrQueue:
    """A queue for lines of any thread within the `with` block; a line never waits.

    If stderr is a terminal, a pipe or a socket, the output of C and C++ libraries goes through the
    queue as well. They write directly to a regular file, so that the last words of an abort are
    kept. Lines that do not fit, or that stderr does not take, are counted and reported later.
    """

    def __init__(self) -> None:
        self._dropped = 0
        """Lines that did not fit."""
        self._untaken = 0
        """Lines that stderr did not take; only the thread counts them."""
        self._told = 0
        self._is_torn = False
        self._is_ending = False

    def __enter__(self) -> Self:
        self._stderr = fcntl.fcntl(_STDERR, fcntl.F_DUPFD_CLOEXEC, _STDERR + 1)
        self._takes_all = not stat.S_ISREG(os.fstat(_STDERR).st_mode)
        self._reading, self._writing = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._writing, False)
        with suppress(OSError):  # the user's limit of pipe memory is reached: keep a small one
            fcntl.fcntl(self._writing, fcntl.F_SETPIPE_SZ, CAPACITY_BYTES)
        if self._takes_all:
            os.dup2(self._writing, _STDERR)
        self._thread = threading.Thread(target=self._empty, name="log", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Write the rest; drop what cannot be written in time, and everything after it."""
        if self._untold():
            self._put("")
        self._is_ending = True
        with suppress(BlockingIOError):
            os.write(self._writing, _END)  # fd 2 keeps the pipe open, so there is no end of file
        self._thread.join(FLUSH_S)
        if self._thread.is_alive():
            os.dup2(os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC), _STDERR)
            return
        if self._takes_all:
            os.dup2(self._stderr, _STDERR)
        for descriptor in (self._stderr, self._reading, self._writing):
            os.close(descriptor)

    def put(self, line: str) -> None:
        """Queue one line, or count it as dropped. Not thread-safe: the caller holds a lock."""
        self._put(f"{line}\n")

    def count_lost(self) -> None:
        """Count a line that could not be formatted; as `put`, not thread-safe."""
        self._dropped += 1

    def _untold(self) -> int:
        return self._dropped + self._untaken - self._told

    def _put(self, text: str) -> None:
        untold = self._untold()
        if untold:
            text = f"log: {untold} lines are missing here, stderr did not take them\n{text}"
        data = f"{chr(10) * self._is_torn}{text}".encode(errors="backslashreplace")
        try:
            written = os.write(self._writing, data)
        except BlockingIOError:
            self._dropped += 1
            return
        self._told += untold
        self._is_torn = written < len(data)
        self._dropped += self._is_torn

    def _empty(self) -> None:
        while True:
            try:
                data = os.read(self._reading, _READ_BYTES)
                self._write(data.replace(_END, b""))
                if self._is_ending and _END in data:
                    return
            except MemoryError:
                self._untaken += 1

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[os.write(self._stderr, rest) :]
            except BlockingIOError:  # another process made the shared terminal non-blocking
                _wait_for_room(self._stderr)
            except OSError:  # no space left, or no reader
                self._untaken += bytes(rest).count(b"\n")
                return


def _wait_for_room(descriptor: int) -> None:
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    poll.poll()
