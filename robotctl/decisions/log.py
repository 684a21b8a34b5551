"""The writer of the journal of decisions."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue
from typing import Any, Final

from robotctl.decisions.journal import (
    ABOUT_SEALS,
    DecisionKind,
    Entry,
    append,
    entries_in,
    files_of,
    last_file,
    locked,
    parse,
    remove_oldest,
)
from robotctl.kernel.constants import DAY_S, NS_PER_S

DAY_BYTES: Final = 130_000
"""Limit on the bytes written in a day: about 500 entries; with RESERVE_BYTES, 50 MB a year."""

RESERVE_BYTES: Final = 6_900
"""Bytes a day beyond DAY_BYTES, for the counts of unwritten entries."""

RESERVED: Final[dict[str, float]] = {
    DecisionKind.REQUEST: 0.5,
    DecisionKind.REFUSED: 0.5,
    DecisionKind.REMOVED: 0.5,
    DecisionKind.START: 0.25,
    DecisionKind.END: 0.25,
}
"""The share of DAY_BYTES that entries of a kind must leave free, above all for stops."""

MAX_WAITING: Final = 1000
"""Limit on entries that wait for the disk; further ones are only counted."""

RETRY_S: Final = 5.0
"""Pause before a failed write is tried again."""

UNQUEUED: Final = "unqueued"
"""Entries that did not fit into the queue are counted under this kind."""

COUNTS_PERIOD_S: Final = 3600.0
"""The counts of unwritten entries are written at most once in this time."""

END_S: Final = 2.0
"""The longest wait for the disk at the end of the daemon."""

_log = logging.getLogger(__name__)


class DecisionLog:
    """Writes the journal of one robot. `add` may be called from any thread, and does not block.

    Entries beyond DAY_BYTES a day are only counted by kind, in a later entry of the kind MORE.
    """

    def __init__(
        self,
        folder: Path,
        keep_s: float,
        *,
        now_ns: Callable[[], int] = time.time_ns,
        steady_s: Callable[[], float] = time.monotonic,
        retry_s: float = RETRY_S,
    ) -> None:
        """Write entries into `folder`; remove files older than `keep_s` seconds (0: none).

        `now_ns` is the wall clock of the entries, `steady_s` the clock of the budget.
        """
        self._folder = folder
        self._keep_s = keep_s
        self._now_ns = now_ns
        self._steady_s = steady_s
        self._retry_s = retry_s
        self._queue: Queue[Entry | None] = Queue()
        self._problem = ""
        # A daemon thread: a disk that hangs must not delay the end of the process.
        self._thread = threading.Thread(target=self._run, name="decisions", daemon=True)
        self._ending = threading.Event()
        self._unqueued = 0
        """The number of entries that did not fit into the queue, set by callers of `add`."""
        self._file: Path | None = None
        """The file of the last entry."""
        self._left = 0.0
        self._left_at_s = 0.0
        self._counts: Counter[str] = Counter()
        self._counted_ns = (0, 0)
        """The times of the first and the last entry that was counted."""
        self._counts_due_s = 0.0

    def add(self, kind: DecisionKind, **values: Any) -> None:
        """Queue an entry with the keyword arguments as its values; see `add_values`."""
        self.add_values(kind, values)

    def add_values(self, kind: DecisionKind, values: Mapping[str, Any]) -> None:
        """Queue an entry with the present time, or only count it if MAX_WAITING entries wait.

        A SOFTWARE or CONFIGURATION entry is written only if it differs from the last such entry.
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
        """Write the queued entries; wait at most END_S for the disk."""
        if self._thread.ident is not None:
            self._ending.set()
            self._queue.put(None)
            self._thread.join(END_S)

    # In the thread

    def _run(self) -> None:
        entry: Entry | None = None
        while True:
            timeout_s = max(self._counts_due_s - self._steady_s(), 0.0) if self._counts else None
            with suppress(Empty):
                entry = self._queue.get(timeout=timeout_s)
                if entry is not None:
                    self._retried(self._write, entry)
            is_end = entry is None
            if self._counts and (is_end or self._steady_s() >= self._counts_due_s):
                self._retried(self._write_counts)
            if is_end:
                return

    def _retried(self, write: Callable[..., None], *arguments: Entry) -> None:
        """Call `write` until it succeeds or the daemon ends; other entries wait in the queue."""
        is_done = False
        while not is_done:
            try:
                write(*arguments)
            except Exception as error:  # noqa: BLE001 - the log must go on, whatever fails
                reason = error.strerror if isinstance(error, OSError) else None
                self._tell(reason or str(error) or type(error).__name__)
                is_done = self._ending.wait(self._retry_s)
            else:
                self._tell("")
                is_done = True

    def _write(self, entry: Entry) -> None:
        """Write an entry, or only count it if it exceeds the budget."""
        if self._unqueued:
            unqueued, self._unqueued = self._unqueued, 0
            self._count(UNQUEUED, unqueued)
        if entry.kind in (DecisionKind.SOFTWARE, DecisionKind.CONFIGURATION) and self._is_known(
            entry
        ):
            return
        if self._file is None:
            self._left, self._left_at_s = DAY_BYTES - self._used(), self._steady_s()
        now_s, size = self._steady_s(), len(entry.line())
        grown = self._left + (now_s - self._left_at_s) * DAY_BYTES / DAY_S
        self._left, self._left_at_s = min(grown, DAY_BYTES), now_s
        if self._left - size < DAY_BYTES * RESERVED.get(entry.kind, 0.0):
            self._count(entry.kind, 1)
        else:
            self._append(entry)
            self._left -= size

    def _count(self, kind: str, number: int) -> None:
        now_ns = self._now_ns()
        self._counted_ns = (self._counted_ns[0] if self._counts else now_ns, now_ns)
        self._counts[kind] += number

    def _write_counts(self) -> None:
        first_ns, last_ns = self._counted_ns
        values = {"counts": dict(self._counts), "first_ns": first_ns, "last_ns": last_ns}
        self._append(Entry(last_ns, DecisionKind.MORE, values))
        self._counts.clear()
        self._counts_due_s = self._steady_s() + COUNTS_PERIOD_S

    def _append(self, entry: Entry) -> None:
        with locked(self._folder):
            path = last_file(self._folder)
            if path != self._file:
                with suppress(OSError):  # tried again at the next start, or with the next file
                    remove_oldest(self._folder, self._keep_s, self._now_ns() / NS_PER_S)
            append(path, [entry])
            self._file = path

    def _used(self) -> int:
        """Return the bytes of the budget that were written in the last 24 h."""
        now_s = self._now_ns() / NS_PER_S
        return sum(
            len(entry.line())
            for path in files_of(self._folder)[-2:]
            for entry in entries_in(path)
            if entry.kind not in ABOUT_SEALS and abs(now_s - entry.time_ns / NS_PER_S) < DAY_S
        )

    def _is_known(self, entry: Entry) -> bool:
        """Return whether the last written entry of the same kind has the same values."""
        for path in reversed(files_of(self._folder)):
            for last in reversed([*entries_in(path, entry.kind)]):
                return last.values == parse(entry.line()).values
        return False

    def _tell(self, problem: str) -> None:
        changed, self._problem = problem != self._problem, problem
        if changed:
            _log.error("%s", self.warning()) if problem else _log.info(
                "decisions are written again"
            )
