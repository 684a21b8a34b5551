"""Calling functions in the loop's thread, from any thread."""

from __future__ import annotations

import threading
from asyncio import AbstractEventLoop
from collections.abc import Callable


class LoopThread:
    """Runs in the loop what any thread passes in; calls from before the loop runs are kept."""

    def __init__(self) -> None:
        self._loop: AbstractEventLoop | None = None
        self._thread_id: int | None = None
        self._waiting: list[Callable[[], object]] = []
        self._given_up = False
        # Reentrant: a signal handler may interrupt a call and call again.
        self._lock = threading.RLock()

    def is_current(self) -> bool:
        """Return whether the caller runs in the loop's thread."""
        return threading.get_ident() == self._thread_id

    def open(self, loop: AbstractEventLoop) -> None:
        """Run the calls that were kept, then later ones; must be called in the loop's thread."""
        with self._lock:
            self._loop, self._thread_id = loop, threading.get_ident()
            waiting, self._waiting = self._waiting, []
            for callback in waiting:  # under the lock: later calls of other threads come after them
                loop.call_soon(callback)

    def give_up(self) -> None:
        """Run kept and later calls in the thread of their caller, because no loop will run."""
        with self._lock:
            self._given_up = True
            waiting, self._waiting = self._waiting, []
        for callback in waiting:
            callback()

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Call `callback` in one of the loop's next turns.

        Raises:
            RuntimeError: The loop is closed.
        """
        with self._lock:
            if self._loop is None and not self._given_up:
                self._waiting.append(callback)
                return
        if self._loop is None:
            callback()
        elif self.is_current():
            self._loop.call_soon(callback)
        else:
            self._loop.call_soon_threadsafe(callback)
