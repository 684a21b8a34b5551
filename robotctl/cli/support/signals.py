"""Signals that end a command."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupted_by(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Let signals that would end this process raise KeyboardInterrupt, as Ctrl-C does.

    After the first of them the others are ignored until the end of the block: a terminal that
    closes sends several, and the reaction to the first must be completed.
    """
    previous = {
        number: signal.getsignal(number)
        for number in numbers
        # nohup ignores SIGHUP on purpose
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler)
    }

    def interrupt(number: int, frame: FrameType | None) -> None:
        for other in previous:
            signal.signal(other, _ignore)
        raise KeyboardInterrupt

    try:
        for number in previous:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def ignoring(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Ignore signals during a step that must be completed."""
    previous = {number: signal.signal(number, _ignore) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _ignore(number: int, frame: FrameType | None) -> None:
    """Do nothing.

    SIG_IGN would be inherited by children, and Python reports an error for a signal that arrived
    just before it was set.
    """
