"""Polls many sources together from time to time, instead of waking the loop for each message.

Waking up for one message costs about 50 us, taking it 2 to 10. So messages that may come late (a
recorder's taps, a flooded topic) are collected for a while, as network drivers collect packets
under load. The DDS threads still write to the eventfds; a second epoll keeps these apart from the
loop's own.
"""

from __future__ import annotations

import select
import time
from asyncio import AbstractEventLoop, TimerHandle
from typing import Protocol

from robotctl.ros.executor.beat import BEAT_NS, beat_before
from robotctl.ros.executor.event_loop import unwatch, watch
from robotctl.ros.executor.time_limits import FLOOD_REST_S, FLOODED_SHARE, NS_PER_S, TURN_NS


class Pooled(Protocol):
    """A source in a pool."""

    def poll(self) -> bool:
        """Deliver what is there; return whether the slice ended before all was delivered."""


class Pool:
    """Polls its sources at the first message, then rests for `rest_s` seconds after each poll.

    Without messages it does not wake the loop. In a flood it rests for FLOOD_REST_S only: the more
    messages wait, the longer Fast DDS takes to add one, so a long rest costs more than it saves.
    """

    def __init__(self, loop: AbstractEventLoop, rest_s: float) -> None:
        self._loop = loop
        self._rest_s = rest_s
        self._busy_ns = self._rested_ns = 0
        self._epoll = select.epoll()
        self._members: dict[int, Pooled] = {}
        self._resting: TimerHandle | None = None
        self._watching = False
        self._watch()

    def add(self, fd: int, source: Pooled) -> None:
        """Poll `source` when its eventfd `fd` becomes readable."""
        self._members[fd] = source
        self._epoll.register(fd, select.EPOLLIN)

    def remove(self, fd: int) -> None:
        """Stop polling the source of `fd`, which must still be open."""
        del self._members[fd]
        self._epoll.unregister(fd)

    def close(self) -> None:
        """Stop polling, and close the epoll."""
        self._unwatch()
        if self._resting is not None:
            self._resting.cancel()
            self._resting = None
        self._epoll.close()

    def _is_closed(self) -> bool:
        return self._epoll.closed

    def _watch(self) -> None:
        if not self._watching:
            self._watching = True
            watch(self._loop, self._epoll.fileno(), self._poll)

    def _unwatch(self) -> None:
        if self._watching:
            self._watching = False
            unwatch(self._loop, self._epoll.fileno())

    def _poll(self) -> None:
        self._resting = None
        if self._is_closed():
            return
        ready = self._epoll.poll(0, len(self._members) or 1)
        if not ready:
            self._watch()
            return
        self._unwatch()
        begun_ns = time.monotonic_ns()
        left = True  # Also after an exception: the other sources continue.
        try:
            left = self._poll_ready(ready, begun_ns + TURN_NS)
        finally:
            if not self._is_closed():
                rest_s = self._rest_after(begun_ns, left=left)
                self._resting = self._loop.call_at(rested_s(rest_s), self._poll)

    def _rest_after(self, begun_ns: int, *, left: bool) -> float:
        """Return how long to rest, by the share of time that polling took since the last rest."""
        now_ns = time.monotonic_ns()
        self._busy_ns += now_ns - begun_ns
        if left:
            return 0.0
        flooded = self._busy_ns > FLOODED_SHARE * (now_ns - self._rested_ns)
        self._busy_ns, self._rested_ns = 0, now_ns
        return min(self._rest_s, FLOOD_REST_S) if flooded else self._rest_s

    def _poll_ready(self, ready: list[tuple[int, int]], end: int) -> bool:
        left = False
        for fd, _ in ready:
            source = self._members.get(fd)
            if source is not None:
                left |= source.poll()
            if self._is_closed():
                return False
            if time.monotonic_ns() > end:
                return True
        return left


def rested_s(rest_s: float) -> float:
    """Return the steady time [s] until which to rest: on a beat, if that shortens it little."""
    until_ns = time.monotonic_ns() + round(rest_s * NS_PER_S)
    if rest_s * NS_PER_S > BEAT_NS:
        until_ns = beat_before(until_ns)
    return until_ns / NS_PER_S
