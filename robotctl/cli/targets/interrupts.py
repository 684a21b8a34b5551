"""Background calls that Ctrl-C may interrupt, and the signals that end a command."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Generic, TypeVar

T = TypeVar("T")


class Background(threading.Thread, Generic[T]):
    """A thread that runs `work` and keeps its result; it does not outlive the process.

    It is not a future: if Ctrl-C interrupts a call of a future, the future's lock may stay locked,
    and the thread, which needs that lock, never ends.
    """

    def __init__(self, work: Callable[[], T]) -> None:
        super().__init__(daemon=True)
        self.is_done = False
        self._work = work
        self._returned: T
        self._raised: BaseException | None = None

    def run(self) -> None:
        """Run the work, and keep what it returns or raises."""
        try:
            self._returned = self._work()
        except BaseException as error:  # noqa: BLE001 - `result` raises it again
            self._raised = error
        self.is_done = True

    def result(self) -> T:
        """Wait for the work, then return what it returned or raise what it raised."""
        self.join()
        if self._raised is not None:
            raise self._raised
        return self._returned


@contextmanager
def interrupted_by(numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Make signals that would end this process raise KeyboardInterrupt, as Ctrl-C does.

    After the first such signal, all are ignored until the end of the block: a terminal that
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
