"""Runs the daemon's tasks, and reports failed tasks as faults."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine
from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap
from typing import Any

from robotctl.base.errors import RobotctlError
from robotctl.kernel.types import Cause, Event, FaultCleared, FaultReported

_log = logging.getLogger(__name__)

RESTART_S = 1.0
"""Pause before a failed task runs again, as a lasting fault must not fill log and journal."""

MAX_DETAIL = 1000
"""Limit on a fault's text in journal and status [characters]."""

RESERVE_BYTES = 16 * 1024 * 1024
"""Size of the reserve of address space for stopping the robot when memory runs out."""

OUT_OF_MEMORY = "out of memory: the robot was stopped, and the daemon ends"

Work = Callable[[], Coroutine[Any, Any, None]]
"""Returns a new coroutine of a task at each start of the task."""


class Supervisor:
    """Runs all tasks, and reports their failures as faults.

    A failed task starts again, but its fault stays. The daemon ends if it runs out of memory.
    """

    def __init__(self, end: Callable[[], None]) -> None:
        self._end = end
        self._dispatch: Callable[[Event], None] | None = None
        self._reserve: mmap | None = mmap(-1, RESERVE_BYTES, MAP_PRIVATE | MAP_ANONYMOUS)

    def check(self) -> None:
        """Raise RobotctlError if the daemon has run out of memory."""
        if self._reserve is None:
            raise RobotctlError(OUT_OF_MEMORY)

    def report_to(self, dispatch: Callable[[Event], None]) -> None:
        """Pass faults to `dispatch` from now on; earlier ones are only logged."""
        self._dispatch = dispatch

    async def run(self, name: str, work: Work) -> None:
        """Run the task `work` until it returns or is cancelled, again after each failure."""
        while True:
            try:
                return await work()
            except Exception as error:  # noqa: BLE001 - any failure stops the robot
                self._report(error, f"the {name} task failed")
            await asyncio.sleep(RESTART_S)

    def callback_failed(self, error: Exception, where: str) -> None:
        """Handle an exception of a ROS callback, as the executor's exception handler."""
        self._report(error, f"the callback of {where} failed")

    def loop_failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handle an exception that no task awaits, as the loop's exception handler."""
        error = context.get("exception")
        if isinstance(error, Exception):
            self._report(error, str(context.get("message", "a callback failed")))
        else:
            loop.default_exception_handler(context)

    def report_state(self, cause: Cause, problem: str) -> None:
        """Report a fault with this cause and text, or clear the fault if the text is ""."""
        if self._dispatch is not None:
            now = time.monotonic_ns()
            fault = FaultReported(now, cause, problem[:MAX_DETAIL])
            self._dispatch(fault if problem else FaultCleared(now, cause))

    def _report(self, error: Exception, what: str) -> None:
        while isinstance(error, ExceptionGroup) and len(error.exceptions) == 1:
            (error,) = error.exceptions  # unwrap the group of a TaskGroup
        if isinstance(error, MemoryError):
            self._run_out(what)
            return
        detail = f"{what} ({type(error).__name__}: {error})"
        _log.error("%s", detail, exc_info=error)
        self._stop_robot(detail[:MAX_DETAIL])

    def _run_out(self, what: str) -> None:
        """Stop the robot and end the daemon at the first lack of memory."""
        if self._reserve is None:
            return
        self._reserve.close()
        self._reserve = None
        self._end()
        _log.error("%s: out of memory", what)
        self._stop_robot(f"{OUT_OF_MEMORY} ({what})")

    def _stop_robot(self, detail: str) -> None:
        if self._dispatch is not None:
            self._dispatch(FaultReported(time.monotonic_ns(), Cause.TASK_DIED, detail))


POLL_S = 0.01

DISCOVERY_S = 4.0
"""Limit on the wait for discovery; on one machine, Fast DDS takes 0.15 s, or 2.6 s at worst."""


async def until(condition: Callable[[], bool], deadline_s: float) -> bool:
    """Wait for `condition()` to be true, at most `deadline_s` [s]; return whether it is."""
    end = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end:
            return False
        await asyncio.sleep(POLL_S)
    return True
