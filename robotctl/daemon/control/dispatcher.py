"""The one place where events enter the kernel and its effects leave it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from robotctl.daemon.control.decisions import Request
from robotctl.daemon.control.journal_writer import Journal
from robotctl.daemon.control.pending_requests import PendingRequests
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.parameter_change import ParameterRequested
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    DriveEnded,
    Effect,
    Event,
    LoopStalled,
    Reply,
)
from robotctl.kernel.units import NS_PER_S

SNAPSHOT_PERIOD_NS = 10 * NS_PER_S
"""The longest part of the journal that must be re-run to know the state at one moment."""


class Control:
    """The owner of the kernel. `dispatch` is synchronous, for the loop's thread only.

    An event that is dispatched while another is handled waits in a FIFO. Each event is journaled
    before it is handled, each effect after it is carried out.
    """

    def __init__(
        self,
        kernel: Kernel,
        journal: Journal,
        carry_out: Callable[[Effect], None],
        requests: PendingRequests,
        on_failure: Callable[[Exception, str], None],
        urgent: Callable[[], Event | None] = lambda: None,
        asked: Callable[[Request], None] = lambda request: None,
    ) -> None:
        """`on_failure(error, where)` is called for an effect that could not be carried out.

        `urgent()` is called before each event. It returns an event that the kernel must handle
        first, that the loop has stalled, or None. `asked(request)` is called for each request
        before it is dispatched.
        """
        self._kernel = kernel
        self._journal = journal
        self._carry_out = carry_out
        self._requests = requests
        self._on_failure = on_failure
        self._urgent = urgent
        self._asked = asked
        self._events: deque[Event] = deque()
        self._busy = False
        self._failing = ""
        self._snapshot_t_ns: int | None = None

    @property
    def state(self) -> State:
        """The kernel's current state."""
        return self._kernel.state

    @property
    def params(self) -> KernelParams:
        """The kernel's current parameters."""
        return self._kernel.params

    def dispatch(self, event: Event) -> None:
        """Let the kernel decide on `event`, and carry out its effects."""
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
        """Write the kernel's state into the journal, now and then every 10 s.

        So a file that begins here can be re-run alone.
        """
        self._snapshot_t_ns = t_ns
        self._journal.snapshot(t_ns, self._kernel)

    def new_request_id(self) -> int:
        """Return a new request id."""
        return self._requests.new_id()

    def begin(self, event: Request) -> asyncio.Future[Reply]:
        """Dispatch a request now; return the future of its reply, set after its effects."""
        reply = self._requests.expect_reply(event.request_id)
        self._asked(event)
        try:
            self.dispatch(event)
        except BaseException:
            reply.cancel()
            raise
        return reply

    async def request(self, event: Request) -> Reply:
        """Dispatch a request and return its reply."""
        return await self.begin(event)

    def decide(self, event: ParameterRequested) -> Reply:
        """Dispatch a request whose reply waits for nothing; return that reply."""
        self._requests.expect_reply_now(event.request_id)
        self._asked(event)
        self.dispatch(event)
        return self._requests.reply_now(event.request_id)

    def expect_end(self, request_id: int) -> asyncio.Future[DriveEnded]:
        """Return the future of the end of the drive that request `request_id` will start."""
        return self._requests.expect_end(request_id)

    def _step(self, event: Event) -> None:
        last = self._snapshot_t_ns
        # The zeros of a stall are sent already, but not yet in the journal.
        is_due = last is not None and event.t_ns - last >= SNAPSHOT_PERIOD_NS
        if is_due and not isinstance(event, LoopStalled):
            self.journal_snapshot(event.t_ns)
        self._journal.event(event)
        problem = ""
        for effect in self._kernel.step(event):
            done = effect
            if problem and isinstance(effect, Reply):
                done = replace(effect, ok=False, message=f"{effect.message}, but {problem}")
            try:
                self._carry_out(done)
            except Exception as error:  # noqa: BLE001 - the other effects must still happen
                problem = f"{type(effect).__name__} failed: {error}"
                self._tell(error, problem)
            self._journal.effect(event.t_ns, effect)
        if not problem:
            self._failing = ""

    def _tell(self, error: Exception, problem: str) -> None:
        if problem != self._failing:  # once, and not at each tick
            self._failing = problem
            self._on_failure(error, problem)
