"""Removes the duplicates of latched messages, so that each message is recorded once.

A subscription gets either latched messages or the messages of volatile publishers, never both
(DDS 1.4, 2.2.3.4), so a topic with both kinds of publisher takes two subscriptions. Each new
subscription gets the latched messages again.
"""

from __future__ import annotations

from typing import TypeVar

from robotctl.ros.executor import SerializedData, ViewSink

Span = tuple[int, int]
"""The first and the last sequence number that one subscription delivered from a publisher."""

NOTHING: Span = (1, 0)
MAX_PUBLISHERS = 1024
"""Limit on remembered publishers of a topic; latched messages of a forgotten one are recorded
again."""

T = TypeVar("T")


class LatchedMerge:
    """Hands each message to the sink once, though two subscriptions may deliver it.

    Each subscription delivers the messages of one publisher in order.
    """

    def __init__(self, sink: ViewSink) -> None:
        self._sink = sink
        self._live: dict[bytes, Span] = {}
        self._latched: dict[bytes, Span] = {}
        self._known: dict[bytes, int] = {}
        """The last sequence number that earlier subscriptions delivered, by publisher."""

    def live(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Take a message of the volatile subscription: a new one, of any publisher."""
        first, _ = self._live.get(gid, (sequence, sequence))
        _keep(self._live, gid, (first, sequence))
        first_latched, last_latched = self._latched.get(gid, NOTHING)
        if not first_latched <= sequence <= last_latched:
            self._sink(data, received_ns, source_ns, sequence, gid)

    def latched(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Take a message of the transient-local subscription: a latched one, or a new one."""
        _, last = self._latched.get(gid, NOTHING)
        if 0 < sequence <= max(last, self._known.get(gid, 0)):
            return  # a publisher that is discovered again after a loss repeats it as well
        if gid not in self._live or sequence < self._live[gid][0]:
            first, _ = self._latched.get(gid, (sequence, sequence))
            _keep(self._latched, gid, (first, sequence))
            self._sink(data, received_ns, source_ns, sequence, gid)

    def restart(self) -> None:
        """Expect new subscriptions, which repeat what the earlier ones delivered."""
        for spans in (self._live, self._latched):
            for gid, (_, last) in spans.items():
                _keep(self._known, gid, max(last, self._known.get(gid, 0)))
            spans.clear()


def _keep(known: dict[bytes, T], gid: bytes, what: T) -> None:
    """Remember a value of a publisher; at the limit, forget the oldest publisher."""
    if gid not in known and len(known) >= MAX_PUBLISHERS:
        del known[next(iter(known))]
    known[gid] = what
