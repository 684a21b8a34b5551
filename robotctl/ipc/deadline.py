"""The deadlines of a task that waits for one thing after another, with one timer for all of them.

`asyncio.timeout` makes and cancels a timer each time, a tenth of what `status` costs.
"""

from __future__ import annotations

import asyncio
import math
from types import TracebackType
from typing import Self


class DeadlineMissed(TimeoutError):
    """The work was cancelled because its time is over."""


class Deadline:
    """A deadline, set anew for each piece of work. One task uses it at a time; it is not nested.

        with deadline.within(10.0):
            await work()

    Like `asyncio.timeout` it cancels the task, and then raises DeadlineMissed, also a TimeoutError.
    """

    def __init__(self) -> None:
        self._task: asyncio.Task[object] | None = None
        self._cancelling = 0
        self._due_s = math.inf
        self._is_missed = False
        self._timer: asyncio.TimerHandle | None = None
        """It fires at `_due_s` or earlier; if earlier, it is set again."""

    def within(self, limit_s: float | None) -> Self:
        """Set the deadline for the work of the `with` block; None: no deadline."""
        loop, self._task = asyncio.get_running_loop(), asyncio.current_task()
        assert self._task is not None
        self._cancelling = self._task.cancelling()
        if limit_s is not None:
            self._due_s = loop.time() + limit_s
            if self._timer is None or self._timer.when() > self._due_s:
                self._set_timer(loop)
        return self

    def miss(self) -> None:
        """Cancel the work as if its time were over."""
        assert self._task is not None
        self._is_missed = True
        self._task.cancel()

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        task, self._task, self._due_s = self._task, None, math.inf
        if self._is_missed and task is not None:
            self._is_missed = False
            ends = kind is not None and issubclass(kind, asyncio.CancelledError | TimeoutError)
            if task.uncancel() <= self._cancelling and ends:
                raise DeadlineMissed from error

    def _set_timer(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = loop.call_at(self._due_s, self._look, loop)

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        timer, self._timer = self._timer, None
        assert timer is not None
        if self._due_s <= timer.when():
            self.miss()
        elif self._due_s < math.inf:
            self._set_timer(loop)
