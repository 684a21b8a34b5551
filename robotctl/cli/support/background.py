"""A call in a thread, while the main thread may be interrupted by Ctrl-C at any time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Background(threading.Thread, Generic[T]):
    """A thread that runs `work` and keeps its result; it does not outlive the process.

    It is not a future: if Ctrl-C interrupts a call of a future, the future's lock may stay taken,
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
