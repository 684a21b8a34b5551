"""The signals that end a process of robotctl, as an event of its loop."""

from __future__ import annotations

import asyncio
import signal


def end_signals() -> asyncio.Event:
    """Return an event that SIGINT, SIGTERM and, unless ignored as by nohup, SIGHUP set."""
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    loop, told = asyncio.get_running_loop(), asyncio.Event()
    for number in numbers:
        loop.add_signal_handler(number, told.set)
    return told
