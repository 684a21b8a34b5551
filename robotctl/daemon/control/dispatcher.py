"""Passes events to the kernel, and has its effects carried out."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from robotctl.base.errors import Refused, RobotctlError
from robotctl.daemon.control.decisions import Request
from robotctl.ipc.advice import advice
from robotctl.ipc.answers import ModeAnswer
from robotctl.kernel.codec import Proof, Snapshot, to_json
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import DriveEnded, Effect, Event, LoopStalled, ParameterRequested, Reply
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, encode
from robotctl.recording.format.names import MADE_BY


class Journal:
    """Writes the kernel's events and effects to the journal."""

    def __init__(
        self, write: Callable[[bytes, int], None], commands: Callable[[], int] = lambda: 0
    ) -> None:
        """`write(serialized, seq)` gets each entry; `commands()` counts the journaled commands."""
        self._write = write
        self._commands = commands
        self._seq = 0
        self._crc = 0

    def snapshot(self, t_ns: int, kernel: Kernel) -> None:
        """Write a snapshot of the kernel, from which a check can repeat later decisions."""
        proof = Proof(self._commands(), self._crc)
        self.add(t_ns, EntryKind.SNAPSHOT, Snapshot(MADE_BY, kernel.params, kernel.state, proof))

    def add(self, t_ns: int, kind: EntryKind, value: Any) -> None:
        """Write an event, or an effect with the time of the event that caused it."""
        entry = JournalEntry(self._seq, t_ns, kind, type(value).__name__, to_json(value))
        serialized = encode(entry)
        self._crc = chained(serialized, self._crc)
        self._write(serialized, self._seq)
        self._seq += 1


@dataclass(frozen=True, slots=True)
class UnsavedReply(Reply):
    """The reply to a stop that happened but could not be saved."""


def granted(reply: Reply, robot: str) -> ModeAnswer:
    """Return the answer to a granted request.

    Raises:
        Refused: The kernel refused the request.
        RobotctlError: The robot has stopped, but the stop could not be saved.
    """
    if isinstance(reply, UnsavedReply):
        raise RobotctlError(*advice(reply.message, reply.remedies, robot))
    if not reply.ok:
        raise Refused(*advice(reply.message, reply.remedies, robot))
    return {"message": reply.message, "mode": reply.mode.name}


T = TypeVar("T", Reply, DriveEnded)


class Pending(Generic[T]):
    """Futures by request id, of replies or of ends of drives. For the loop's thread only."""

    def __init__(self) -> None:
        self._waiting: dict[int, asyncio.Future[T]] = {}

    def expect(self, request_id: int) -> asyncio.Future[T]:
        """Return a new future for this request, whose result `settle` sets."""
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._waiting[request_id] = future
        future.add_done_callback(lambda _: self._waiting.pop(request_id, None))
        return future

    def settle(self, result: T) -> None:
        """Set the result of the request's future, if any."""
        future = self._waiting.get(result.request_id)
        if future is not None and not future.done():
            future.set_result(result)


class PendingRequests:
    """Gives each request an id, and has the futures of its reply and of its drive's end."""

    def __init__(self) -> None:
        self.replies: Pending[Reply] = Pending()
        self.ends: Pending[DriveEnded] = Pending()
        self._last_id = 0
        self._replies_now: dict[int, Reply | None] = {}

    def new_id(self) -> int:
        """Return a new request id."""
        self._last_id += 1
        return self._last_id

    def expect_reply_now(self, request_id: int) -> None:
        """Announce that the next dispatch brings this request's reply, for `reply_now`."""
        self._replies_now[request_id] = None

    def keep_now(self, reply: Reply) -> bool:
        """Keep the reply if `expect_reply_now` announced it; return whether it did."""
        is_expected = reply.request_id in self._replies_now
        if is_expected:
            self._replies_now[reply.request_id] = reply
        return is_expected

    def reply_now(self, request_id: int) -> Reply:
        """Return the reply to this request, which its dispatch has brought, and forget it."""
        reply = self._replies_now.pop(request_id)
        assert reply is not None, "the request was dispatched while another event was handled"
        return reply


SNAPSHOT_PERIOD_NS = 10 * NS_PER_S
"""Period of snapshots, and so the most time that a check of one decision must repeat."""


class Control:
    """The owner of the kernel, for the loop's thread only.

    An event that is dispatched while another event is handled waits in a FIFO. Each event is
    journaled before the kernel handles it, each effect after it was carried out or has failed.
    """

    def __init__(
        self,
        kernel: Kernel,
        journal: Journal,
        requests: PendingRequests,
        on_failure: Callable[[Exception, str], None],
        urgent: Callable[[], Event | None] = lambda: None,
        asked: Callable[[Request], None] = lambda request: None,
    ) -> None:
        """`asked(request)` is called for each request, `on_failure` for an effect that failed.

        `urgent()` returns an event to handle before the dispatched one, or None.
        """
        self._kernel = kernel
        self._journal = journal
        self.carry_out: Callable[[Effect], None] = _nothing_yet
        """Carries out an effect."""

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
        """Pass `event` to the kernel, and carry out its effects."""
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
        """Journal a snapshot of the kernel now, and every 10 s from now on."""
        self._snapshot_t_ns = t_ns
        self._journal.snapshot(t_ns, self._kernel)

    def stamp(self) -> tuple[int, int]:
        """Return the first two fields of a new request: the steady time [ns] and an id."""
        return time.monotonic_ns(), self._requests.new_id()

    def begin(self, event: Request) -> asyncio.Future[Reply]:
        """Dispatch a request now, and return the future of the kernel's reply."""
        reply = self._requests.replies.expect(event.request_id)
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
        """Dispatch a request that the kernel answers at once, and return the reply."""
        self._requests.expect_reply_now(event.request_id)
        self._asked(event)
        self.dispatch(event)
        return self._requests.reply_now(event.request_id)

    def expect_end(self, request_id: int) -> asyncio.Future[DriveEnded]:
        """Return a future that is set when the drive of this request ends."""
        return self._requests.ends.expect(request_id)

    def _step(self, event: Event) -> None:
        last = self._snapshot_t_ns
        # The zeros of a stall are sent already, but not yet in the journal.
        is_due = last is not None and event.t_ns - last >= SNAPSHOT_PERIOD_NS
        if is_due and not isinstance(event, LoopStalled):
            self.journal_snapshot(event.t_ns)
        self._journal.add(event.t_ns, EntryKind.EVENT, event)
        problem = ""
        for effect in self._kernel.step(event):
            done = effect
            if problem and isinstance(effect, Reply):
                done = replace(effect, ok=False, message=f"{effect.message}, but {problem}")
            try:
                self.carry_out(done)
            except Exception as error:  # noqa: BLE001 - the other effects must still happen
                problem = f"{type(effect).__name__} failed: {error}"
                self._tell(error, problem)
            self._journal.add(event.t_ns, EntryKind.EFFECT, effect)
        if not problem:
            self._failing = ""

    def _tell(self, error: Exception, problem: str) -> None:
        if problem != self._failing:  # once, and not at each tick
            self._failing = problem
            self._on_failure(error, problem)


def _nothing_yet(effect: Effect) -> None:
    raise AssertionError(f"nothing carries out {effect} yet")
