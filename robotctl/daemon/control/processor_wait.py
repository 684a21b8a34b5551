"""What the system's scheduler gives one thread, as Linux keeps account of it."""

from __future__ import annotations

import os
import threading
from typing import Final

LINE_BYTES: Final = 128
"""More than the line of `schedstat`: three numbers."""

_PRESSURE = "/proc/pressure/cpu"


class ProcessorWait:
    """Account of the thread that makes this object; asked from any thread, until `close`.

    The file is opened here, once: later there may be no free descriptor.
    """

    def __init__(self) -> None:
        self._account: int | None = None
        try:
            path = f"/proc/self/task/{threading.get_native_id()}/schedstat"
            self._account = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:  # this system keeps none
            return

    def close(self) -> None:
        """Give the account's descriptor back."""
        if self._account is not None:
            os.close(self._account)
            self._account = None

    def waited_ns(self) -> int:
        """Return how long the thread has waited to run, up to when it last ran; 0 if unknown."""
        if self._account is None:
            return 0
        return int(os.pread(self._account, LINE_BYTES, 0).split()[1])


def pressure() -> str:
    """Return how short processors are, as a clause; "" where the system does not say (PSI)."""
    try:
        with open(_PRESSURE, encoding="ascii") as file:
            fields = file.readline().split()
        return f", CPU pressure {float(fields[1].removeprefix('avg10=')):.0f} %"
    except (OSError, ValueError, IndexError):
        return ""
