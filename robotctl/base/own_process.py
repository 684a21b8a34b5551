"""A process of robotctl: its standard streams, its limit of open files, the signals that end it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import asyncio


def open_standard_streams() -> None:
    """Open /dev/null in place of each standard stream that is closed.

    Otherwise a socket or file would get its descriptor, and output to stderr would go there.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


LEAST_OPEN_FILES: Final = 128
"""With fewer, a daemon does not start: without a free one it could answer no client."""

ENOUGH_OPEN_FILES: Final = 256
MORE_OPEN_FILES: Final = "raise the limit with ulimit -n 1024, or LimitNOFILE in a unit"


def end_signals() -> asyncio.Event:
    """Return an event that SIGINT, SIGTERM and, unless ignored as by nohup, SIGHUP set."""
    import asyncio  # here: a quick command opens its streams without them
    import signal

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    loop, told = asyncio.get_running_loop(), asyncio.Event()
    for number in numbers:
        loop.add_signal_handler(number, told.set)
    return told
