"""A call beside the main thread, which a Ctrl-C may interrupt at any instant."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Background(threading.Thread, Generic[T]):
    """Carries out `work`, from `start` on, in a thread that does not outlive the process.

    Not a future: whoever is interrupted while it asks one for its state may leave the lock taken
    that the thread needs to end.
    """

    def __init__(self, work: Callable[[], T]) -> None:
        super().__init__(daemon=True)
        self.is_done = False
        self._work = work
        self._returned: T
        self._raised: BaseException | None = None

    def run(self) -> None:
        """Keep what the work returns or raises."""
        try:
            self._returned = self._work()
        except BaseException as error:  # noqa: BLE001 - raised again where the result is asked for
            self._raised = error
        self.is_done = True

    def result(self) -> T:
        """Wait for what the work returned; raises what it raised."""
        self.join()
        if self._raised is not None:
            raise self._raised
        return self._returned
