"""Signals that end a command from outside."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupted_by(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Let signals that would end this process and leave the daemon behind act as Ctrl-C does.

    After the first of them the others are ignored until the end of the block: a closing terminal
    sends several, and what the first one begins must be carried out.
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
    """Ignore signals during a step that must be carried out."""
    previous = {number: signal.signal(number, _ignore) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _ignore(number: int, frame: FrameType | None) -> None:
    """Not SIG_IGN: Python complains of a signal that came just before, and children inherit it."""
