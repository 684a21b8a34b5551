"""Sends messages at their moments: an absolute schedule on the steady clock, in one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from robotctl.replay.clock import Clock
from robotctl.replay.timeline import Entry
from robotctl.replay.timing import Lateness

Send = Callable[[bytes], bool]
"""Hands a serialized message to the middleware; False where that did not take it."""

LEAD_NS: Final = 20_000_000
"""Between the start and the first message, so that it is on time as well."""

SLICE_NS: Final = 50_000_000
"""How long a stop or a withheld topic may take to be noticed."""


@dataclass(slots=True)
class Sent:
    """What came of one topic's messages so far."""

    send: Send | None
    """None once the topic is withheld."""

    sent: int = 0
    failed: int = 0
    withheld: int = 0


class Player:
    """Sends every entry through its topic's `Send`; `rate` None sends as fast as possible.

    `run` belongs to one thread; everything else may be used from any.
    """

    def __init__(
        self,
        batches: Iterable[Sequence[Entry]],
        sends: dict[str, Send],
        *,
        rate: float | None,
        clock: Clock,
    ) -> None:
        self.topics = {topic: Sent(send) for topic, send in sends.items()}
        self.lateness = Lateness()
        self.position_ns = 0
        """Recorded time that has been played."""

        self.late_ns = 0
        """How late the last message was."""

        self._batches = batches
        self._rate = rate
        self._clock = clock
        self._stopped = False

    def stop(self) -> None:
        """Send nothing more."""
        self._stopped = True

    def withhold(self, topic: str) -> None:
        """Send nothing more of one topic."""
        self.topics[topic].send = None

    @property
    def sent(self) -> int:
        """Messages that the middleware took, of all topics."""
        return sum(topic.sent for topic in self.topics.values())

    def run(self) -> None:
        """Send until the entries end or `stop` is called."""
        rate = self._rate
        start_ns = self._clock.now_ns() + LEAD_NS
        for batch in self._batches:
            for at_ns, topic, data in batch:
                due_ns = start_ns if rate is None else start_ns + round(at_ns / rate)
                if rate is not None:
                    self._wait_until(due_ns)
                if self._stopped:
                    return
                self._send(self.topics[topic], data, due_ns if rate is not None else None)
                self.position_ns = at_ns

    def _wait_until(self, due_ns: int) -> None:
        clock = self._clock
        while not self._stopped:
            soon_ns = clock.now_ns() + SLICE_NS
            if due_ns <= soon_ns:
                clock.sleep_until(due_ns)
                return
            clock.sleep_until(soon_ns)

    def _send(self, topic: Sent, data: bytes, due_ns: int | None) -> None:
        send = topic.send
        if send is None:
            topic.withheld += 1
            return
        if due_ns is not None:
            self.late_ns = self._clock.now_ns() - due_ns
            self.lateness.add(self.late_ns)
        if send(data):
            topic.sent += 1
        else:
            topic.failed += 1
