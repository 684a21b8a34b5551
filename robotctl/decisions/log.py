"""The writer of the journal of decisions: a thread that writes at most 50 MB a year."""

from __future__ import annotations

import errno
import logging
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

from robotctl.decisions.journal import (
    FILE_BYTES,
    DecisionKind,
    Entry,
    content_of,
    files_of,
    hash_of,
    open_last,
    parse,
    remove_oldest,
)
from robotctl.kernel.units import DAY_S, NS_PER_S

DAY_BYTES: Final = 130_000
"""Limit on the bytes written in a day: about 500 entries; with RESERVE_BYTES, 50 MB a year."""

RESERVE_BYTES: Final = 6_900
"""Bytes a day beyond DAY_BYTES, for the MORE entries with the counts of what was not written."""

RESERVED: Final[dict[str, float]] = {
    DecisionKind.REQUEST: 0.5,
    DecisionKind.REFUSED: 0.5,
    DecisionKind.REMOVED: 0.5,
    DecisionKind.START: 0.25,
    DecisionKind.END: 0.25,
}
"""The share of DAY_BYTES that entries of a kind must leave free for other kinds: a flood of
requests, or a daemon that crashes and restarts each second, must not crowd out the stops."""


class Budget:
    """Limits how many bytes are written: the budget grows at a constant rate, up to DAY_BYTES.

    It also counts by kind the entries that are not written; an entry MORE contains these counts.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        """`now_s` is a steady clock [s]."""
        self._now_s = now_s
        self._at_s = now_s()
        self._left: float = DAY_BYTES
        self._folded: Counter[str] = Counter()
        self._first_ns = self._last_ns = 0

    def grants(self, entry: Entry, size: int) -> bool:
        """Reserve `size` bytes for an entry; return False if too few are left: then `fold` it."""
        now_s = self._now_s()
        grown = self._left + (now_s - self._at_s) * DAY_BYTES / DAY_S
        self._left, self._at_s = min(grown, DAY_BYTES), now_s
        if self._left - size < DAY_BYTES * RESERVED.get(entry.kind, 0.0):
            return False
        self._left -= size
        return True

    def fold(self, entry: Entry, number: int = 1) -> None:
        """Count `number` entries of the kind of `entry` that are not written."""
        if not self._folded:
            self._first_ns = entry.time_ns
        self._folded[entry.kind] += number
        self._last_ns = entry.time_ns

    def begin(self, used: int) -> None:
        """Start with the budget of one day, less the `used` bytes that were written already."""
        self._left = max(DAY_BYTES - used, 0.0)

    @property
    def has_folded(self) -> bool:
        """Whether there are counts that are not written yet."""
        return bool(self._folded)

    def counts(self) -> Entry:
        """Return the entry that contains the counts."""
        counts: dict[str, Any] = {str(kind): count for kind, count in self._folded.items()}
        values = {"counts": counts, "first_ns": self._first_ns, "last_ns": self._last_ns}
        return Entry(self._last_ns, DecisionKind.MORE, values)

    def forget_counts(self) -> None:
        """Count from 0 again."""
        self._folded.clear()


_log = logging.getLogger(__name__)

MAX_WAITING: Final = 1000
"""Limit on entries that wait while the disk hangs or is full; further ones are only counted."""

RETRY_S: Final = 5.0
"""Pause before a failed write is tried again."""

UNQUEUED: Final = "unqueued"
"""Entries that did not fit into the queue are counted under this kind."""

COUNTS_PERIOD_S: Final = 3600.0
"""The counts of unwritten entries are written at most once in this time."""

END_S: Final = 2.0
"""How long the end of the daemon waits for the disk, at most."""


class DecisionLog:
    """Writes the log of one robot. `add` may be called from any thread, and does not block."""

    def __init__(
        self,
        folder: Path,
        keep_s: float,
        *,
        now_ns: Callable[[], int] = time.time_ns,
        steady_s: Callable[[], float] = time.monotonic,
        retry_s: float = RETRY_S,
    ) -> None:
        """Write entries into `folder`; keep its files for `keep_s` seconds, or forever if it is 0.

        `now_ns` is the wall clock of the entries, `steady_s` the clock of the budget.
        """
        self._folder = folder
        self._keep_s = keep_s
        self._now_ns = now_ns
        self._steady_s = steady_s
        self._retry_s = retry_s
        self._queue: SimpleQueue[Entry | None] = SimpleQueue()
        self._problem = ""
        # A daemon thread: a disk that hangs must not delay the end of the process.
        self._thread = threading.Thread(target=self._run, name="decisions", daemon=True)
        self._unqueued = 0
        """How many entries did not fit into the queue; changed by the threads that call `add`."""
        self._unqueued_told = 0
        self._waiting: list[Entry] = []
        self._ending = False
        self._descriptor = -1
        self._size = 0
        self._prev = ""
        self._torn = False
        self._budget = Budget(steady_s)
        self._counts_due_s = 0.0

    def add(self, kind: DecisionKind, **values: Any) -> None:
        """Queue an entry with the present time."""
        self.add_values(kind, values)

    def add_values(self, kind: DecisionKind, values: Mapping[str, Any]) -> None:
        """Queue an entry with the present time; the keys of `values` may be any text.

        A SOFTWARE or CONFIGURATION entry is written only if it differs from the last of its kind.
        """
        if self._queue.qsize() >= MAX_WAITING:
            self._unqueued += 1
            return
        self._queue.put(Entry(self._now_ns(), kind, values))
        if self._thread.ident is None:
            try:
                self._thread.start()
            except (RuntimeError, MemoryError) as error:  # the limit of threads is reached
                self._problem = str(error)

    def warning(self) -> str:
        """Return a sentence if decisions cannot be written now, else ""."""
        if not self._problem:
            return ""
        return (
            f"the journal of decisions ({self._folder}) is not written: {self._problem} "
            "(tried again; the recording holds them)"
        )

    def close(self) -> None:
        """Write what is queued, for END_S at most."""
        if self._thread.ident is not None:
            self._queue.put(None)
            self._thread.join(END_S)

    # In the thread

    def _run(self) -> None:
        while True:
            try:
                self._turn()
            except Exception as error:  # noqa: BLE001 - the log must go on, whatever fails
                self._fail(error)
            if self._ending:
                with suppress(OSError):  # what is written was synced
                    self._close()
                return

    def _turn(self) -> None:
        """Wait for entries and write them; also write the counts if they are due."""
        self._take()
        if self._descriptor < 0:
            self._open()
        unqueued = self._unqueued
        if unqueued > self._unqueued_told:
            self._budget.fold(Entry(self._now_ns(), UNQUEUED, {}), unqueued - self._unqueued_told)
            self._unqueued_told = unqueued
        while self._waiting:
            self._write(self._waiting[0])
            del self._waiting[0]
        if self._budget.has_folded and (self._ending or self._steady_s() >= self._counts_due_s):
            self._append(self._budget.counts())
            self._budget.forget_counts()
            self._counts_due_s = self._steady_s() + COUNTS_PERIOD_S
        os.fsync(self._descriptor)
        self._tell("")

    def _take(self) -> None:
        """Wait for queued entries, and move them to `_waiting`; count those beyond MAX_WAITING."""
        timeout_s = None
        if self._waiting:
            timeout_s = self._retry_s
        elif self._budget.has_folded:
            timeout_s = max(self._counts_due_s - self._steady_s(), self._retry_s)
        with suppress(Empty):
            entry = self._queue.get(timeout=timeout_s)
            while entry is not None:
                if len(self._waiting) < MAX_WAITING:
                    self._waiting.append(entry)
                else:
                    self._budget.fold(entry)
                entry = self._queue.get_nowait()
            self._ending = True

    def _open(self) -> None:
        """Open the last file; read the last entry's hash and the bytes written in the last 24 h."""
        now_s = self._now_ns() / NS_PER_S
        remove_oldest(self._folder, self._keep_s, now_s)
        self._descriptor = open_last(self._folder)
        used = 0
        for path in files_of(self._folder)[-2:]:
            content = content_of(path)
            for line in content.splitlines():
                with suppress(ValueError):
                    entry, _ = parse(line)
                    self._prev = hash_of(line)
                    used += len(line) if abs(now_s - entry.time_ns / NS_PER_S) < DAY_S else 0
            self._torn = bool(content) and not content.endswith(b"\n")
        self._size = os.fstat(self._descriptor).st_size
        self._budget.begin(used)

    def _write(self, entry: Entry) -> None:
        """Write an entry, or only count it if it exceeds the budget.

        A SOFTWARE or CONFIGURATION entry that `_is_known` is left out.
        """
        if entry.kind in (DecisionKind.SOFTWARE, DecisionKind.CONFIGURATION) and self._is_known(
            entry
        ):
            return
        if self._budget.grants(entry, len(entry.line(self._prev)) + 1):
            self._append(entry)
        else:
            self._budget.fold(entry)

    def _append(self, entry: Entry) -> None:
        if self._size >= FILE_BYTES:
            self._close()
            self._open()
        line = entry.line(self._prev)
        data = b"\n" * self._torn + line + b"\n"
        if os.write(self._descriptor, data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._torn = False
        self._prev = hash_of(line)
        self._size += len(data)

    def _is_known(self, entry: Entry) -> bool:
        """Return whether the last written entry of the same kind has the same values."""
        marker = f'"kind":"{entry.kind}"'.encode()
        same = parse(entry.line(""))[0].values
        for path in reversed(files_of(self._folder)):
            for line in reversed(content_of(path).splitlines()):
                if marker in line:
                    with suppress(ValueError):
                        last, _ = parse(line)
                        if last.kind == entry.kind:
                            return last.values == same
        return False

    def _fail(self, error: Exception) -> None:
        reason = error.strerror if isinstance(error, OSError) else None
        self._tell(reason or str(error) or type(error).__name__)
        with suppress(OSError):
            self._close()

    def _close(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def _tell(self, problem: str) -> None:
        changed, self._problem = problem != self._problem, problem
        if changed:
            _log.error("%s", self.warning()) if problem else _log.info(
                "decisions are written again"
            )
