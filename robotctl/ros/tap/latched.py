"""Latched messages, each once: beside those of publishers that latch nothing, and again and again.

A subscription gets what was latched before it came, or the messages of publishers that latch
nothing, never both (DDS 1.4, 2.2.3.4): a topic that has both kinds takes two subscriptions. And
each new subscription gets what is latched once more.
"""

from __future__ import annotations

from typing import TypeVar

from robotctl.ros.executor import SerializedData, ViewSink

Span = tuple[int, int]
"""The first and the last sequence number that one subscription delivered of a publisher."""

NOTHING: Span = (1, 0)
MAX_PUBLISHERS = 1024
"""Remembered of a topic; what one that is forgotten repeats is recorded twice."""

T = TypeVar("T")


class LatchedMerge:
    """Hands each message of the subscriptions of a topic to the sink once.

    Each subscription delivers the messages of a publisher in their order.
    """

    def __init__(self, sink: ViewSink) -> None:
        self._sink = sink
        self._live: dict[bytes, Span] = {}
        self._latched: dict[bytes, Span] = {}
        self._known: dict[bytes, int] = {}
        """The last number of each publisher that earlier subscriptions delivered."""

    def live(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Take a message of the subscription that gets what every publisher sends from now on."""
        first, _ = self._live.get(gid, (sequence, sequence))
        _keep(self._live, gid, (first, sequence))
        first_latched, last_latched = self._latched.get(gid, NOTHING)
        if not first_latched <= sequence <= last_latched:
            self._sink(data, received_ns, source_ns, sequence, gid)

    def latched(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Take a message of the subscription that gets what publishers have latched, and send."""
        _, last = self._latched.get(gid, NOTHING)
        if 0 < sequence <= max(last, self._known.get(gid, 0)):
            return  # a publisher that was lost for a while and is found again repeats it, too
        if gid not in self._live or sequence < self._live[gid][0]:
            first, _ = self._latched.get(gid, (sequence, sequence))
            _keep(self._latched, gid, (first, sequence))
            self._sink(data, received_ns, source_ns, sequence, gid)

    def subscribe_anew(self) -> None:
        """From now on others deliver; what they repeat is known already."""
        for spans in (self._live, self._latched):
            for gid, (_, last) in spans.items():
                _keep(self._known, gid, max(last, self._known.get(gid, 0)))
            spans.clear()


def _keep(known: dict[bytes, T], gid: bytes, what: T) -> None:
    """Remember it of a publisher, and forget the one that has been known for longest."""
    if gid not in known and len(known) >= MAX_PUBLISHERS:
        del known[next(iter(known))]
    known[gid] = what
