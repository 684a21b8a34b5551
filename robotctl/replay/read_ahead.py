"""Reads a recording in a thread, so that the thread that keeps time never waits for the disk."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Final, Self

from robotctl.replay.timeline import Entry

BATCH_ENTRIES: Final = 256
BATCH_BYTES: Final = 1 << 20
AHEAD_ENTRIES: Final = 16_384
AHEAD_BYTES: Final = 64 << 20
"""How much may wait to be sent; one batch more where a single one is larger."""


class ReadAhead:
    """Iterates over batches of `entries`, which are read in a thread while the block lasts."""

    def __init__(self, entries: Iterable[Entry]) -> None:
        self._entries = entries
        self._changed = threading.Condition()
        self._batches: deque[tuple[list[Entry], int]] = deque()
        self._waiting_entries = 0
        self._waiting_bytes = 0
        self._ended = False
        self._closed = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)

    def __enter__(self) -> Self:
        """Begin to read."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop reading, and wait until the thread has."""
        self.close()
        self._thread.join()

    def close(self) -> None:
        """End the iteration at the next batch; callable from any thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator[list[Entry]]:
        """The batches, each as soon as it is read. Raises what reading raised, at its place."""
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
                self._changed.notify_all()
            yield batch
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            self._read()
        except BaseException as failure:  # noqa: BLE001 - raised again by the one who iterates
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
                if len(batch) >= BATCH_ENTRIES or size >= BATCH_BYTES:
                    full, full_size, batch, size = batch, size, [], 0
                    if not self._put(full, full_size):
                        return
        finally:
            if batch:
                self._put(batch, size)

    def _put(self, batch: list[Entry], size: int) -> bool:
        """Wait for room and add the batch; False once nobody wants it any more."""
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
            self._waiting_entries + entries > AHEAD_ENTRIES
            or self._waiting_bytes + size > AHEAD_BYTES
        )
