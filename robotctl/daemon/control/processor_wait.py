"""How long a thread has waited for a processor, from the accounting of Linux."""

from __future__ import annotations

import os
import threading
from typing import Final

LINE_BYTES: Final = 128
"""Longer than the line of `schedstat`, which has three numbers."""

_PRESSURE = "/proc/pressure/cpu"


class ProcessorWait:
    """The waiting time of the thread that creates this object; read from any thread.

    The file is opened once, at the creation: later no descriptor may be free.
    """

    def __init__(self) -> None:
        self._account: int | None = None
        try:
            path = f"/proc/self/task/{threading.get_native_id()}/schedstat"
            self._account = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:  # this system has no accounting
            return

    def close(self) -> None:
        """Close the file."""
        if self._account is not None:
            os.close(self._account)
            self._account = None

    def waited_ns(self) -> int:
        """Return the total time that the thread has waited to run; 0 if unknown."""
        if self._account is None:
            return 0
        return int(os.pread(self._account, LINE_BYTES, 0).split()[1])


def pressure() -> str:
    """Return the CPU pressure (PSI) as a clause, "" if unknown."""
    try:
        with open(_PRESSURE, encoding="ascii") as file:
            fields = file.readline().split()
        return f", CPU pressure {float(fields[1].removeprefix('avg10=')):.0f} %"
    except (OSError, ValueError, IndexError):
        return ""
