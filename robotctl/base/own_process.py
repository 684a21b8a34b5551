"""The standard streams, open files and end signals of this process."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import asyncio


def open_standard_streams() -> None:
    """Open /dev/null in place of each standard stream that is closed."""
    # Otherwise the next socket or file would get such a descriptor, and receive the output.
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


LEAST_OPEN_FILES: Final = 128
"""The smallest limit of open files with which a daemon starts."""

ENOUGH_OPEN_FILES: Final = 256
MORE_OPEN_FILES: Final = "raise the limit with ulimit -n 1024, or LimitNOFILE in a unit"


def end_signals() -> asyncio.Event:
    """Return an event that SIGINT, SIGTERM and, unless ignored (nohup), SIGHUP set."""
    import asyncio  # here: quick commands import this module, but not asyncio
    import signal

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    loop, told = asyncio.get_running_loop(), asyncio.Event()
    for number in numbers:
        loop.add_signal_handler(number, told.set)
    return told
