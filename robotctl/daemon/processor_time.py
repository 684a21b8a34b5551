"""What the system's scheduler gives one thread, as Linux keeps account of it."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Final

LINE_BYTES: Final = 128
"""More than the line of `schedstat`: three numbers."""

LOOK_S: Final = 0.01
"""How long a look takes whether a thread is given a processor."""

STARVED_SHARE: Final = 0.1
"""A thread that wants to run, and runs for less of a look than this, is starved."""


class ProcessorTime:
    """Of the thread that makes this object; asked from any thread, until `close`."""

    def __init__(self) -> None:
        task = Path(f"/proc/self/task/{threading.get_native_id()}")
        self._stat = task / "stat"
        self._clock = time.pthread_getcpuclockid(threading.get_ident())
        self._account: int | None = None
        try:
            self._account = os.open(task / "schedstat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:  # this system keeps none
            return

    def close(self) -> None:
        """Give the account's descriptor back."""
        if self._account is not None:
            os.close(self._account)
            self._account = None

    def waited_ns(self) -> int:
        """How long the thread has waited to run, up to when it last was let; 0 if unknown."""
        if self._account is None:
            return 0
        return int(os.pread(self._account, LINE_BYTES, 0).split()[1])

    def is_starved(self) -> bool:
        """Look for `LOOK_S` whether the thread wants to run and is not let."""
        if not self._wants_to_run():
            return False
        before_ns = time.clock_gettime_ns(self._clock)
        time.sleep(LOOK_S)
        ran_s = (time.clock_gettime_ns(self._clock) - before_ns) / 1e9
        return self._wants_to_run() and ran_s < STARVED_SHARE * LOOK_S

    def _wants_to_run(self) -> bool:
        """Say whether the thread is in state R, running or about to (proc(5))."""
        return self._stat.read_text().rpartition(")")[2].split()[0] == "R"
