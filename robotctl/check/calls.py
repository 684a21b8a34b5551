"""Check recorded calls of `set_mode` and `estop` against requests and replies of the journal."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Final, NamedTuple

from robotctl.check.commands import LATE_NS
from robotctl.check.ends import Ending, EndingOf, JournalEnd
from robotctl.check.inputs import AFTER_NS
from robotctl.check.journal import Moments
from robotctl.check.report import Report
from robotctl.check.times import ClockChanges
from robotctl.check.topics import RobotTopics
from robotctl.kernel.codec import Snapshot
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Effect, Event, ModeRequested, Reply
from robotctl.messages.cdr import CdrReader
from robotctl.recording.read.messages import Message

_GID_BYTES = 16


RECEIVED, SENT = 1, 2
"""The event types of a server, as in ServiceEventInfo.msg; the two others are a client's."""


@dataclass(frozen=True, slots=True)
class Service:
    """A service that requests a mode; without `has_mode`, the mode is EMERGENCY_STOP."""

    name: str
    type_name: str
    has_mode: bool


SERVICES = (
    Service("set_mode", "robot_controller/srv/SetMode_Event", True),
    Service("estop", "std_srvs/srv/Trigger_Event", False),
)


class RecordedAnswer(NamedTuple):
    """A response to a call, sent at `publish_ns`; `mode` is None if the service has no mode."""

    ok: bool
    text: str
    mode: int | None
    publish_ns: int


class ServiceEvent(NamedTuple):
    """An event of a server; `call` identifies the call by client and number.

    `requested` is the number of the mode in a request, None in a response.
    """

    call: tuple[bytes, int]
    requested: int | None
    answer: RecordedAnswer | None


def read_service_event(service: Service, data: bytes, publish_ns: int) -> ServiceEvent | None:
    """Return the server's event in a message, or None for a client's event.

    Raises:
        struct.error: The message cannot be read.
    """
    reader = CdrReader(data)
    (kind,) = reader.take("B")
    reader.take("I", 2)  # the stamp
    client = reader.octets(_GID_BYTES)
    (number,) = reader.take("q")
    if kind not in (RECEIVED, SENT):
        return None
    call = client, number
    (has_request,) = reader.take("I")
    requested = reader.take("B")[0] if has_request else None
    (has_response,) = reader.take("I")
    if kind == RECEIVED:
        if requested is None:
            raise struct.error("a call without a request")
        return ServiceEvent(
            call, requested if service.has_mode else Mode.EMERGENCY_STOP.value, None
        )
    if not has_response:
        raise struct.error("a response without contents")
    ok, text = bool(reader.take("B")[0]), reader.text()
    mode = reader.take("B")[0] if service.has_mode else None
    return ServiceEvent(call, None, RecordedAnswer(ok, text, mode, publish_ns))


MAX_CALLS: Final = 100_000
"""The maximum number of compared calls of one service."""

MAX_AHEAD: Final = 1_000
"""A call is compared with at most this many requests."""

ANSWER_NS: Final = NS_PER_S
"""A request at most this long before the end may lack its response."""

MANY_IN_WORK: Final = 128
"""A refusal as busy is plausible above this number of open calls; robotctl accepts 256."""

_BUSY = re.compile(r"busy: \d+ requests wait for their reply; try again")


@dataclass(slots=True)
class Asked:
    """A request for a mode, in journal entry `seq`; `moments` are the times of its handling."""

    seq: int
    requested: int
    moments: Moments
    reply: Reply | None = None


@dataclass(slots=True)
class Call:
    """A recorded call: the `requested` mode, the time of receipt, and the response, if any.

    `in_work` is the number of calls without a response at the time of receipt.
    """

    requested: int
    publish_ns: int
    in_work: int
    answer: RecordedAnswer | None = None

    @property
    def was_refused_as_busy(self) -> bool:
        """Whether the service refused the call because of too many open calls."""
        answer = self.answer
        return (
            self.in_work > MANY_IN_WORK
            and answer is not None
            and not answer.ok
            and _BUSY.fullmatch(answer.text) is not None
        )


def _fits(asked: Asked, call: Call, least_ns: int, clock: ClockChanges) -> bool:
    steady_ns, begin_ns, end_ns = asked.moments
    return (asked.requested == call.requested and begin_ns >= least_ns) and (
        begin_ns - LATE_NS <= call.publish_ns <= end_ns + LATE_NS or clock.is_near(steady_ns)
    )


MAX_UNDER_WAY: Final = 1_000
"""The maximum number of recorded calls at the end without a request in the journal."""

END_NS = 2 * NS_PER_S
"""The call of a request at most this long before the end may be missing."""


class ServiceChecks:
    """Checks all services that request a mode, once a snapshot has a `Proof` (count and CRC)."""

    def __init__(self, report: Report, topics: RobotTopics, clock: ClockChanges) -> None:
        open_calls: dict[tuple[bytes, int], Call] = {}
        self._all = [
            ServiceCheck(report, topics, service, open_calls, clock) for service in SERVICES
        ]
        self._is_on = False

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each recorded topic, by topic name."""
        return {each.topic: each.message for each in self._all if each.is_recorded}

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Begin the comparison if the snapshot has a `Proof` (command count and CRC)."""
        if snapshot.proof is not None and not self._is_on:
            self._is_on = True
            for each in self._all:
                each.begin(log_ns)

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        self._is_on = False

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Read the request and the replies of a step; `seq` is the number of the event's entry."""
        if not self._is_on:
            return
        if isinstance(event, ModeRequested):
            for each in self._all:
                each.request(event, seq, moments)
        for effect in effects:
            if isinstance(effect, Reply):
                for each in self._all:
                    each.reply(effect)

    def end(self, ending: EndingOf, moment: JournalEnd) -> None:
        """Report the differences; call this at the end of the journal."""
        if self._is_on and ending(None).is_own:
            for each in self._all:
                each.end(ending(each.topic), moment)


class ServiceCheck:
    """Compares calls of one service with the requests and replies of the journal."""

    def __init__(
        self,
        report: Report,
        topics: RobotTopics,
        service: Service,
        open_calls: dict[tuple[bytes, int], Call],
        clock: ClockChanges,
    ) -> None:
        name, self._is_told = topics.told(f"service.{service.name}")
        self.topic = f"{name}/_service_event"
        self.is_recorded = topics.types.get(self.topic) == service.type_name
        self._source = f"the ROS service {topics.namespace}/{service.name}"
        self._open_calls = open_calls
        self._calls: list[Call] = []
        self._asked: list[Asked] = []
        self._open_requests: dict[int, Asked] = {}
        self._answers_alone = 0
        """The number of responses without a recorded call."""

        self._others = sorted(topics.of_type(service.type_name) - {self.topic})
        self._is_left_out = topics.leaves_out(self.topic, service.type_name)
        self._clip_begin_ns = topics.clip_begin_ns
        self._report = report
        self._service = service
        self._clock = clock
        self._begin_ns: int | None = None
        self._newest = 0
        self._has_one_publisher = True
        self._unreadable = 0

    def begin(self, log_ns: int) -> None:
        """Compare from the time `log_ns` on [ns since the epoch]."""
        self._begin_ns = log_ns
        for each in (self._open_calls, self._calls, self._asked, self._open_requests):
            each.clear()

    def message(self, message: Message) -> None:
        """Read a service event: a received call or a sent response."""
        if self._begin_ns is None:
            return
        self._has_one_publisher &= message.sequence > self._newest
        self._newest = max(message.sequence, self._newest)
        try:
            event = read_service_event(self._service, message.data, message.publish_ns)
        except struct.error:
            self._unreadable += 1
            return
        if event is None:
            return
        if event.requested is None:
            answered = self._open_calls.pop(event.call, None)
            if answered is None:
                self._answers_alone += 1
            else:
                answered.answer = event.answer
        elif not self._is_full:
            call = Call(event.requested, message.publish_ns, len(self._open_calls))
            self._open_calls[event.call] = call
            self._calls.append(call)

    def request(self, event: ModeRequested, seq: int, moments: Moments) -> None:
        """Add the mode request `event` of journal entry `seq`, if it came by this service."""
        if event.source == self._source and not self._is_full:
            asked = Asked(seq, event.requested, moments)
            self._open_requests[event.request_id] = asked
            self._asked.append(asked)

    def reply(self, reply: Reply) -> None:
        """Add a reply of the journal to its request."""
        asked = self._open_requests.pop(reply.request_id, None)
        if asked is not None:
            asked.reply = reply

    @property
    def _is_full(self) -> bool:
        return max(len(self._calls), len(self._asked)) >= MAX_CALLS

    def end(self, ending: Ending, moment: JournalEnd) -> None:
        """Report the differences between calls and journal; call this at the end of the journal."""
        if self._unreadable:
            self._report.miss(f"{self._unreadable} messages of {self.topic} cannot be read")
            return
        if self._is_full:
            self._report.miss(f"of the calls on {self.topic} only the first were compared")
            return
        unasked, unheard, first = [], [], 0
        pairs: list[tuple[Asked, Call]] = []
        is_part = ending.is_clip or not ending.has_begin
        begin_ns = (self._begin_ns or 0) if is_part else 0  # of earlier calls, requests are before
        for call in self._calls:
            if call.was_refused_as_busy or call.publish_ns < begin_ns:
                continue
            ahead = range(first, min(first + MAX_AHEAD, len(self._asked)))
            # A clip and a later file lack the calls of the first requests, which calls precede.
            least_ns = call.publish_ns if is_part and not self._clock.note else 0
            at = next(
                (at for at in ahead if _fits(self._asked[at], call, least_ns, self._clock)), None
            )
            if at is None:
                unasked.append(call)
                continue
            unheard += self._asked[first:at]
            pairs.append((self._asked[at], call))
            first = at + 1  # calls and requests have the same order
        self._tell_unasked(unasked, ending, moment.log_ns)
        self._tell_unheard(unheard, self._asked[first:], ending, moment.t_ns)
        self._tell_answers(pairs, ending, moment.t_ns)

    def _tell_unasked(self, unasked: list[Call], ending: Ending, end_log_ns: int) -> None:
        """Report the calls without a request in the journal."""
        begin_ns = (self._begin_ns or 0) + LATE_NS
        unasked = [call for call in unasked if begin_ns < call.publish_ns]
        if not (ending.is_whole and ending.ledger is not None):
            # The request of a call that is under way may come after the end of the journal.
            last_ns = inf if self._clock.has_changed else end_log_ns + AFTER_NS
            first_ns = end_log_ns - LATE_NS
            judged = [call for call in unasked if not first_ns < call.publish_ns <= last_ns]
            if len(unasked) - len(judged) <= MAX_UNDER_WAY:
                unasked = judged
        if not unasked:
            return
        text = (
            f"{len(unasked)} calls on {self.topic} are not requests in the journal, the first is "
            f"for mode {unasked[0].requested}"
        )
        if self._has_one_publisher:
            ending.accuse(text)
        else:
            self._report.notes.append(f"{text}: another node serves it as well")

    def _tell_unheard(
        self, unheard: list[Asked], last: list[Asked], ending: Ending, end_ns: int
    ) -> None:
        """Report the requests without a call; `last` are those after the last call."""
        recent = [each for each in last if end_ns - each.moments[0] <= END_NS]
        unheard = unheard + last[: len(last) - len(recent)]
        if ending.ledger is not None and ending.is_whole:
            unheard += recent  # it was closed: they were recorded
        if ending.is_clip or not ending.is_whole:
            # An earlier file, or the source of a clip, may have the call.
            early_ns = max(self._begin_ns or 0, self._clip_begin_ns) + LATE_NS
            unheard = [each for each in unheard if each.moments[1] > early_ns]
        if not unheard:
            return
        text = (
            f"{len(unheard)} requests of {self._source} are not recorded as calls, "
            f"the first is entry {unheard[0].seq}"
        )
        is_counted = len(unheard) <= ending.lost
        if self._is_left_out and not (self.is_recorded or is_counted):
            self._report.notes.append(f"{self.topic} was not recorded, as configured")
        elif not (self._calls or self._is_told or is_counted) and self._others:
            self._report.notes.append(
                f"{text}: its name may be remapped, as {self._others[0]} is of it"
            )
        else:
            ending.lack(len(unheard), text)

    def _tell_answers(self, pairs: list[tuple[Asked, Call]], ending: Ending, end_ns: int) -> None:
        """Report the first difference of a response and its reply, and missing responses."""
        for asked, call in pairs:
            if text := self._difference(asked, call):
                ending.accuse(f"{self.topic}: {text}")
                return
        unanswered = sum(
            asked.reply is not None
            and call.answer is None
            and end_ns - asked.moments[0] > ANSWER_NS
            for asked, call in pairs
        )
        alone = self._answers_alone if ending.is_whole and not ending.is_clip else 0
        if ending.ledger is None and alone:
            text = f"{self.topic}: the calls of {alone} responses are not recorded"
            self._report.miss(f"{text}; {ending.unknown_losses}")
        elif ending.ledger is not None and unanswered + alone > ending.lost:
            self._report.miss(
                f"{self.topic}: of {unanswered} calls the response is not recorded, "
                f"and of {alone} responses the call"
            )

    def _difference(self, asked: Asked, call: Call) -> str:
        """Return the difference of a response and the reply in the journal, "" for none."""
        reply, answer = asked.reply, call.answer
        if reply is None or answer is None:
            return ""
        name = f" --robot {self._report.robot}"
        said, decided = answer.text.replace(name, ""), reply.message.replace(name, "")
        rest = said.removeprefix(decided)
        failed = rest.startswith(", but ")  # an effect before the reply failed
        if not said.startswith(decided) or not (failed or bool(rest) is bool(reply.remedies)):
            return f"a response says {answer.text[:80]!r}, and entry {asked.seq} got {decided!r}"
        if answer.ok is not reply.ok and not (failed and reply.ok):
            return f"a response says {answer.ok}, and entry {asked.seq} got {reply.ok}"
        if answer.mode not in (None, reply.mode.value):
            return f"a response shows mode {answer.mode}, and entry {asked.seq} got {reply.mode}"
        if answer.publish_ns < asked.moments[1] - LATE_NS and not self._clock.is_near(
            asked.moments[0]
        ):
            return f"the response to entry {asked.seq} was sent before the request"
        return ""
