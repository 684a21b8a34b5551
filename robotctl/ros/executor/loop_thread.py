"""The way into the loop's thread, from that thread and from any other."""

from __future__ import annotations

import threading
from asyncio import AbstractEventLoop
from collections.abc import Callable


class LoopThread:
    """Runs in the loop what any thread hands over; until there is a loop, it waits for one."""

    def __init__(self) -> None:
        self._loop: AbstractEventLoop | None = None
        self._thread_id: int | None = None
        self._waiting: list[Callable[[], object]] = []
        self._given_up = False
        # A signal handler may come in here again, in the midst of it.
        self._lock = threading.RLock()

    def is_current(self) -> bool:
        """Whether the caller runs in the loop's thread."""
        return threading.get_ident() == self._thread_id

    def open(self, loop: AbstractEventLoop) -> None:
        """Let everything in, what waited first; to be called in the loop's thread."""
        with self._lock:
            self._loop, self._thread_id = loop, threading.get_ident()
            waiting, self._waiting = self._waiting, []
        for callback in waiting:
            loop.call_soon(callback)

    def give_up(self) -> None:
        """No loop will come: run here what waits for it, and what comes later where it comes."""
        with self._lock:
            self._given_up = True
            waiting, self._waiting = self._waiting, []
        for callback in waiting:
            callback()

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Run it in one of the loop's next turns.

        Raises:
            RuntimeError: the loop is closed.
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
