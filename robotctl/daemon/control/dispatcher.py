"""The one place through which everything reaches the kernel, and its effects the world."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from robotctl.daemon.control.journal_writer import Journal
from robotctl.daemon.control.pending_requests import PendingRequests
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    DriveEnded,
    DriveRequested,
    Effect,
    Event,
    ModeRequested,
    Reply,
    ResetRequested,
)
from robotctl.kernel.units import NS_PER_S

Request = ModeRequested | ResetRequested | DriveRequested

SNAPSHOT_PERIOD_NS = 10 * NS_PER_S
"""So much of the journal, at most, must be decided again to know the state at some moment."""


class Control:
    """Owns the kernel. `dispatch` belongs to the loop's thread and is synchronous.

    An event that is dispatched while another is being carried out waits its turn; nothing
    overtakes. Each event and effect is journaled, an effect after it was carried out.
    """

    def __init__(
        self,
        kernel: Kernel,
        journal: Journal,
        carry_out: Callable[[Effect], None],
        requests: PendingRequests,
        on_failure: Callable[[Exception, str], None],
        urgent: Callable[[], Event | None] = lambda: None,
    ) -> None:
        """`on_failure(error, where)` is told of an effect that could not be carried out.

        `urgent()` is asked before each event for what the kernel must know first: that the loop
        has stalled.
        """
        self._kernel = kernel
        self._journal = journal
        self._carry_out = carry_out
        self._requests = requests
        self._on_failure = on_failure
        self._urgent = urgent
        self._events: deque[Event] = deque()
        self._busy = False
        self._failing = ""
        self._snapshot_t_ns: int | None = None

    @property
    def state(self) -> State:
        """What the kernel knows now."""
        return self._kernel.state

    def dispatch(self, event: Event) -> None:
        """Let the kernel decide on `event`, and carry out what it decides."""
        if self._busy:
            self._events.append(event)
            return
        urgent = self._urgent()
        if urgent is not None:
            self._events.append(urgent)
        self._events.append(event)
        self._busy = True
        try:
            while self._events:
                self._step(self._events.popleft())
        finally:
            self._busy = False

    def journal_snapshot(self, t_ns: int) -> None:
        """Write the kernel's state into the journal, now and every 10 s from now on."""
        self._snapshot_t_ns = t_ns
        self._journal.snapshot(t_ns, self._kernel)

    def new_request_id(self) -> int:
        """Return a number for one request."""
        return self._requests.new_id()

    def begin(self, event: Request) -> asyncio.Future[Reply]:
        """Dispatch a request now; its reply comes once what it confirms has happened."""
        reply = self._requests.expect_reply(event.request_id)
        try:
            self.dispatch(event)
        except BaseException:
            reply.cancel()
            raise
        return reply

    async def request(self, event: Request) -> Reply:
        """Dispatch a request and return its reply."""
        return await self.begin(event)

    def expect_end(self, request_id: int) -> asyncio.Future[DriveEnded]:
        """Return a future of the end of the drive that `request_id` is about to begin."""
        return self._requests.expect_end(request_id)

    def _step(self, event: Event) -> None:
        last = self._snapshot_t_ns
        if last is not None and event.t_ns - last >= SNAPSHOT_PERIOD_NS:
            self.journal_snapshot(event.t_ns)
        self._journal.event(event)
        problem = ""
        for effect in self._kernel.step(event):
            done = effect
            if problem and isinstance(effect, Reply):
                done = replace(effect, ok=False, message=f"{effect.message}, but {problem}")
            try:
                self._carry_out(done)
            except Exception as error:  # noqa: BLE001 - the other effects must happen all the same
                problem = f"{type(effect).__name__} failed: {error}"
                self._tell(error, problem)
            self._journal.effect(event.t_ns, effect)
        if not problem:
            self._failing = ""

    def _tell(self, error: Exception, problem: str) -> None:
        if problem != self._failing:  # once, and not at each tick that it lasts
            self._failing = problem
            self._on_failure(error, problem)
