"""Reads a recording in a separate thread, so that the player never waits for the disk."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Final, Self

from robotctl.replay.timeline import Entry

BATCH_ENTRIES: Final = 256
BATCH_BYTES: Final = 1 << 20
AHEAD_ENTRIES: Final = 16_384
"""How many messages may wait to be sent, by default."""

AHEAD_BYTES: Final = 64 << 20
"""Maximum size of the waiting messages; one batch may be larger."""


class ReadAhead:
    """Iterates over batches of `entries`. A thread reads them while the block lasts.

    It reads about `ahead` entries in advance.
    """

    def __init__(self, entries: Iterable[Entry], ahead: int = AHEAD_ENTRIES) -> None:
        self._entries = entries
        self._ahead = ahead
        self._batch_entries = min(BATCH_ENTRIES, ahead)
        self._given: list[Entry] = []
        self._changed = threading.Condition()
        self._batches: deque[tuple[list[Entry], int]] = deque()
        self._waiting_entries = 0
        self._waiting_bytes = 0
        self._ended = False
        self._closed = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)

    def __enter__(self) -> Self:
        """Start to read."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop reading, and wait for the end of the thread."""
        self.close()
        self._thread.join()

    def close(self) -> None:
        """End the iteration at the next batch. May be called from any thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator[list[Entry]]:
        """Yield the batches when they are read. An exception of the reader is raised after them."""
        while True:
            with self._changed:
                while not (self._batches or self._ended or self._closed):
                    self._changed.wait()
                if self._closed:
                    return
                if not self._batches:
                    break
                batch, size = self._batches.popleft()
                self._waiting_entries -= len(batch)
                self._waiting_bytes -= size
                self._given = batch
                self._changed.notify_all()
            yield batch
        if self._failure is not None:
            raise self._failure

    def count(self, after_ns: int, until_ns: int) -> int:
        """Return how many of the messages read lie in a time span. Callable from any thread."""
        with self._changed:
            batches = [self._given, *(batch for batch, _ in self._batches)]
        return sum(
            bisect_right(batch, until_ns, key=_at_ns) - bisect_right(batch, after_ns, key=_at_ns)
            for batch in batches
        )

    def _run(self) -> None:
        try:
            self._read()
        except BaseException as failure:  # noqa: BLE001 - raised again by the iteration
            self._failure = failure
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _read(self) -> None:
        batch: list[Entry] = []
        size = 0
        try:
            for entry in self._entries:
                batch.append(entry)
                size += len(entry[2])
                if len(batch) >= self._batch_entries or size >= BATCH_BYTES:
                    full, full_size, batch, size = batch, size, [], 0
                    if not self._put(full, full_size):
                        return
        finally:
            if batch:
                self._put(batch, size)

    def _put(self, batch: list[Entry], size: int) -> bool:
        """Wait for room and add the batch; return False after `close`."""
        with self._changed:
            while not self._closed and self._batches and self._is_full(len(batch), size):
                self._changed.wait()
            if self._closed:
                return False
            self._batches.append((batch, size))
            self._waiting_entries += len(batch)
            self._waiting_bytes += size
            self._changed.notify_all()
            return True

    def _is_full(self, entries: int, size: int) -> bool:
        return (
            self._waiting_entries + entries > self._ahead
            or self._waiting_bytes + size > AHEAD_BYTES
        )


def _at_ns(entry: Entry) -> int:
    return entry[0]
