"""Whatever fails in the daemon becomes an event: the kernel answers with zero and ERROR."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine
from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap
from typing import Any

from robotctl.errors import RobotctlError
from robotctl.kernel.types import Cause, Event, FaultCleared, FaultReported

_log = logging.getLogger(__name__)

RESTART_S = 1.0
"""How long a task that died stays away: a fault that lasts must not fill log and journal."""

MAX_DETAIL = 1000
"""Characters of a fault that journal and status are told; the log has it whole."""

RESERVE_BYTES = 16 * 1024 * 1024
"""Given back when there is no memory left, so that the daemon can stop the robot and end. Its pages
are never touched: it takes address space only."""

OUT_OF_MEMORY = "out of memory: the robot was stopped, and the daemon ends"

Work = Callable[[], Coroutine[Any, Any, None]]
"""Makes the coroutine of a task; called again for each restart."""


class Supervisor:
    """Runs tasks and takes the exceptions that nobody else takes.

    A task that died is started again, so that status, stop and zeros stay available; its fault
    stays until the daemon is restarted. Without memory nothing can be relied on: then the robot is
    stopped and the daemon told to end.
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
        """Hand faults to the kernel from now on; before, they are only logged."""
        self._dispatch = dispatch

    async def run(self, name: str, work: Work) -> None:
        """Run a task until it returns or is cancelled."""
        while True:
            try:
                return await work()
            except Exception as error:  # noqa: BLE001 - whatever it was, the robot stops
                self._report(error, f"the {name} task failed")
            await asyncio.sleep(RESTART_S)

    def callback_failed(self, error: Exception, where: str) -> None:
        """Take the exception of a ROS callback; the exception handler of the executor."""
        self._report(error, f"the callback of {where} failed")

    def loop_failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Take what asyncio has nobody else to tell of; the exception handler of the loop."""
        error = context.get("exception")
        if isinstance(error, Exception):
            self._report(error, str(context.get("message", "a callback failed")))
        else:
            loop.default_exception_handler(context)

    def unreachable(self, problem: str) -> None:
        """Take that the control socket cannot be reached, "" when it can again."""
        if self._dispatch is not None:
            now, cause = time.monotonic_ns(), Cause.UNREACHABLE
            self._dispatch(
                FaultReported(now, cause, problem[:MAX_DETAIL])
                if problem
                else FaultCleared(now, cause)
            )

    def _report(self, error: Exception, what: str) -> None:
        while isinstance(error, ExceptionGroup) and len(error.exceptions) == 1:
            (error,) = error.exceptions  # what a TaskGroup wraps around
        if isinstance(error, MemoryError):
            self._run_out(what)
            return
        detail = f"{what} ({type(error).__name__}: {error})"
        _log.error("%s", detail, exc_info=error)
        self._stop_robot(detail[:MAX_DETAIL])

    def _run_out(self, what: str) -> None:
        """End the daemon, once: what fails meanwhile for want of memory changes nothing more."""
        if self._reserve is None:
            return
        self._reserve.close()
        self._reserve = None
        self._end()
        _log.error("%s: out of memory", what)
        self._stop_robot(OUT_OF_MEMORY)

    def _stop_robot(self, detail: str) -> None:
        if self._dispatch is not None:
            self._dispatch(FaultReported(time.monotonic_ns(), Cause.TASK_DIED, detail))
