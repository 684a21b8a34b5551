"""Signals that end a command from outside."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


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
