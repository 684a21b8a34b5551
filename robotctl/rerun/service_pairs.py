"""Pairs each call of a service on the wire with its request in the journal, in their order."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from robotctl.kernel.types import ModeRequested, Reply
from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.command_counts import LATE_NS
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.service_events import RecordedAnswer, ServiceEvent

MAX_CALLS: Final = 100_000
"""The number of calls of a service that are compared."""

MAX_AHEAD: Final = 1_000
"""How many requests are searched for the one of a call: those between them are not recorded."""

ANSWER_NS: Final = NS_PER_S
"""How long before the end a request may lack its response: it waits for the disk."""

MANY_IN_WORK: Final = 128
"""With fewer open calls no call is refused as busy: robotctl takes 256 at a time."""

_BUSY = re.compile(r"busy: \d+ requests wait for their reply; try again")


@dataclass(slots=True)
class Asked:
    """A request in the journal: number of its entry, mode, when it was handled, its reply."""

    seq: int
    requested: int
    moments: Moments
    reply: Reply | None = None


@dataclass(slots=True)
class Call:
    """A call on the wire: the mode, when it was received, its response.

    `in_work` is the number of calls without a response then.
    """

    requested: int
    publish_ns: int
    in_work: int
    answer: RecordedAnswer | None = None

    @property
    def was_refused_as_busy(self) -> bool:
        """Whether the call was refused without a decision."""
        answer = self.answer
        return (
            self.in_work > MANY_IN_WORK
            and answer is not None
            and not answer.ok
            and _BUSY.fullmatch(answer.text) is not None
        )


class ServicePairs:
    """The calls of one service and its requests in the journal."""

    def __init__(self, source: str, open_calls: dict[tuple[bytes, int], Call]) -> None:
        """`source` is how the journal names the service; `open_calls` are those of all services."""
        self.source = source
        self.calls: list[Call] = []
        self.asked: list[Asked] = []
        self.unasked: list[Call] = []
        """The calls without a request in the journal."""

        self.unheard: list[Asked] = []
        """The requests without a call, and not those after the last call with a request."""

        self.last_unheard: list[Asked] = []
        """The requests after the last call with a request."""

        self.answers_alone = 0
        """The number of responses whose call is not recorded."""

        self.pairs: list[tuple[Asked, Call]] = []
        self._open_calls = open_calls
        self._open_requests: dict[int, Asked] = {}

    @property
    def is_full(self) -> bool:
        """Whether there were more calls than are compared."""
        return max(len(self.calls), len(self.asked)) >= MAX_CALLS

    def event(self, event: ServiceEvent, publish_ns: int) -> None:
        """Take an event of the service."""
        if event.requested is not None:
            if not self.is_full:
                call = Call(event.requested, publish_ns, len(self._open_calls))
                self._open_calls[event.call] = call
                self.calls.append(call)
            return
        answered = self._open_calls.pop(event.call, None)
        if answered is None:
            self.answers_alone += 1
        else:
            answered.answer = event.answer

    def request(self, event: ModeRequested, seq: int, moments: Moments) -> None:
        """Take a request of the journal, with the number of its entry."""
        if event.source == self.source and not self.is_full:
            asked = Asked(seq, event.requested, moments)
            self._open_requests[event.request_id] = asked
            self.asked.append(asked)

    def reply(self, reply: Reply) -> None:
        """Take a reply of the journal."""
        asked = self._open_requests.pop(reply.request_id, None)
        if asked is not None:
            asked.reply = reply

    def pair(self, clock: ClockChanges) -> None:
        """Pair calls and requests, each in their order."""
        first = 0
        for call in self.calls:
            if call.was_refused_as_busy:
                continue
            ahead = range(first, min(first + MAX_AHEAD, len(self.asked)))
            at = next((at for at in ahead if _fits(self.asked[at], call, clock)), None)
            if at is None:
                self.unasked.append(call)
                continue
            self.unheard += self.asked[first:at]
            self.pairs.append((self.asked[at], call))
            first = at + 1
        self.last_unheard = self.asked[first:]

    def unanswered(self, end_ns: int) -> list[Asked]:
        """Return the requests with a reply whose response is not recorded, without the last ones.

        `end_ns` is the end of the journal.
        """
        return [
            asked
            for asked, call in self.pairs
            if asked.reply is not None
            and call.answer is None
            and end_ns - asked.moments[0] > ANSWER_NS
        ]


def _fits(asked: Asked, call: Call, clock: ClockChanges) -> bool:
    steady_ns, begin_ns, end_ns = asked.moments
    return asked.requested == call.requested and (
        begin_ns - LATE_NS <= call.publish_ns <= end_ns + LATE_NS or clock.is_near(steady_ns)
    )
