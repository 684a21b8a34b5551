"""Other processes: waiting for one that may not be our child, and being ended by one."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


@contextmanager
def watched(pid: int) -> Iterator[int | None]:
    """A descriptor that becomes readable when the process ends; None where it is out of sight.

    Taken before the process is asked to end: afterwards its pid may be somebody else's.
    """
    try:
        descriptor = os.pidfd_open(pid)
    except OSError:  # gone already, or in another pid namespace
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def readable_within(descriptor: int, seconds: float) -> bool:
    """Wait until a descriptor can be read, or for so long."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(0, int(seconds * 1000))))


@contextmanager
def interrupted_by(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Let signals that would end this process and leave the daemon behind act as Ctrl-C does."""
    previous = {
        number: signal.signal(number, signal.default_int_handler)
        for number in numbers
        if signal.getsignal(number) is signal.SIG_DFL  # nohup ignores SIGHUP on purpose
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
