"""A bounded queue in front of stderr, and the thread that empties it.

Whoever reads stderr may stop reading: a terminal after Ctrl-S, a full pipe, a disk that hangs. The
queue is a pipe whose writing end never waits.
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
"""What may wait to be written: what a user may ask of a pipe (/proc/sys/fs/pipe-max-size)."""

FLUSH_S = 1.0
"""How long the end waits until what is queued is written."""

_STDERR = 2
_READ_BYTES = 65536
_END = b"\0"


class StderrQueue:
    """Takes lines from any thread within the `with` block, in their order, without waiting.

    Where stderr is a terminal, a pipe or a socket, it takes what C and C++ libraries write as
    well. Into a regular file they write themselves: what one says as it aborts must not be lost.
    Lines that do not fit, or that stderr does not take, are counted and told in a later line.
    """

    def __init__(self) -> None:
        self._dropped = 0
        """Lines that did not fit."""
        self._untaken = 0
        """Lines that stderr did not take; the thread alone counts them."""
        self._told = 0
        self._is_torn = False
        self._is_ending = False

    def __enter__(self) -> Self:
        self._stderr = fcntl.fcntl(_STDERR, fcntl.F_DUPFD_CLOEXEC, _STDERR + 1)
        self._takes_all = not stat.S_ISREG(os.fstat(_STDERR).st_mode)
        self._reading, self._writing = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._writing, False)
        with suppress(OSError):  # the user has too many large pipes: then it is a small one
            fcntl.fcntl(self._writing, fcntl.F_SETPIPE_SZ, CAPACITY_BYTES)
        if self._takes_all:
            os.dup2(self._writing, _STDERR)
        self._thread = threading.Thread(target=self._empty, name="log", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Write the rest; what cannot be written in time is dropped, and so is all after it."""
        if self._untold():
            self._put("")
        self._is_ending = True
        with suppress(BlockingIOError):
            os.write(self._writing, _END)  # no end of file comes while fd 2 is the pipe as well
        self._thread.join(FLUSH_S)
        if self._thread.is_alive():
            os.dup2(os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC), _STDERR)
            return
        if self._takes_all:
            os.dup2(self._stderr, _STDERR)
        for descriptor in (self._stderr, self._reading, self._writing):
            os.close(descriptor)

    def put(self, line: str) -> None:
        """Queue one line, or count it. The caller sees to it that one thread at a time is here."""
        self._put(f"{line}\n")

    def count_lost(self) -> None:
        """Count a line that could not even be made; as `put`, one thread at a time."""
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
            except BlockingIOError:  # somebody made the terminal that we share non-blocking
                _wait_for_room(self._stderr)
            except OSError:  # no space left, or no reader any more
                self._untaken += bytes(rest).count(b"\n")
                return


def _wait_for_room(descriptor: int) -> None:
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    poll.poll()
