"""Calls into the loop's thread from other threads, and the thread's scheduling."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop


class LoopThread:
    """Runs functions in the loop, for callers in any thread."""

    def __init__(self) -> None:
        self._loop: AbstractEventLoop | None = None
        self._thread_id: int | None = None
        self._waiting: list[Callable[[], object]] = []
        self._given_up = False
        # Reentrant: a signal handler may interrupt a method that has the lock, and call it again.
        self._lock = threading.RLock()

    def is_current(self) -> bool:
        """Return whether the caller runs in the loop's thread."""
        return threading.get_ident() == self._thread_id

    def open(self, loop: AbstractEventLoop) -> None:
        """Run functions in `loop` from now on, first the waiting ones. Call this in its thread."""
        with self._lock:
            self._loop, self._thread_id = loop, threading.get_ident()
            waiting, self._waiting = self._waiting, []
            for callback in waiting:  # under the lock: later calls of other threads come after them
                loop.call_soon(callback)

    def give_up(self) -> None:
        """Stop waiting for a loop. Run the waiting functions here, and later ones at once."""
        with self._lock:
            self._given_up = True
            waiting, self._waiting = self._waiting, []
        for callback in waiting:
            callback()

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Call `callback` in a later turn of the loop (after `open`), or at once after `give_up`.

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


class FifoScheduling:
    """Runs the calling thread, but none that it starts, under SCHED_FIFO until `restore`."""

    def __init__(self, priority: int) -> None:
        """Request SCHED_FIFO at `priority`, 1 (low) to 99. `description` is the result."""
        self._former: tuple[int, os.sched_param] | None = None
        self._thread = threading.get_native_id()
        former = (os.sched_getscheduler(self._thread), os.sched_getparam(self._thread))
        try:
            # Not inherited: a real-time DDS thread would delay the robot's other threads.
            os.sched_setscheduler(
                self._thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority)
            )
        except PermissionError:
            self.description = (
                f"SCHED_OTHER (SCHED_FIFO {priority} is not permitted: "
                "give the user an rtprio limit or the process CAP_SYS_NICE)"
            )
        else:
            self._former = former
            self.description = f"SCHED_FIFO {priority}"

    def restore(self) -> None:
        """Restore the thread's former scheduling. Any thread may call this."""
        if self._former is not None:
            policy, parameter = self._former
            self._former = None
            os.sched_setscheduler(self._thread, policy, parameter)
