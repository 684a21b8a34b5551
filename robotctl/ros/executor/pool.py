"""Sources that are looked at together, now and then, instead of at every single message.

Waking up for one message costs more than taking it: some 50 us against 2 to 10. What nobody waits
for (a recorder's taps) and what comes faster than anybody can care about (a flooded topic)
therefore collects for a moment, as a network driver lets packets collect under load. The DDS
thread goes on writing to the eventfds; a second epoll keeps them apart from the loop's own.
"""

from __future__ import annotations

import select
import time
from asyncio import AbstractEventLoop, TimerHandle
from typing import Protocol

from robotctl.ros.executor.time_limits import FLOOD_REST_S, FLOODED_SHARE, TURN_NS


class Pooled(Protocol):
    """What a pool looks after."""

    def look(self) -> bool:
        """Deliver what is there; whether something is left because the slice is over."""


class Pool:
    """Wakes the loop for the first message after a rest, and rests `rest_s` after each look.

    While nothing comes, nothing turns. In a flood it rests for FLOOD_REST_S: the more messages
    wait, the longer Fast DDS takes to add one, so a long rest costs more than it saves.
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
        """Look after the source whose eventfd this is."""
        self._members[fd] = source
        self._epoll.register(fd, select.EPOLLIN)

    def remove(self, fd: int) -> None:
        """Look after it no more; the descriptor must still be open."""
        del self._members[fd]
        self._epoll.unregister(fd)

    def close(self) -> None:
        """Give everything back."""
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
            self._loop.add_reader(self._epoll.fileno(), self._look)

    def _unwatch(self) -> None:
        if self._watching:
            self._watching = False
            if not self._loop.is_closed():
                self._loop.remove_reader(self._epoll.fileno())

    def _look(self) -> None:
        self._resting = None
        if self._is_closed():
            return
        ready = self._epoll.poll(0, len(self._members) or 1)
        if not ready:
            self._watch()
            return
        self._unwatch()
        begun_ns = time.monotonic_ns()
        left = True  # Also where a look ends in an exception: the others go on.
        try:
            left = self._look_at(ready, begun_ns + TURN_NS)
        finally:
            if not self._is_closed():
                rest_s = self._rest_after(begun_ns, left=left)
                self._resting = self._loop.call_later(rest_s, self._look)

    def _rest_after(self, begun_ns: int, *, left: bool) -> float:
        """Return how long to rest: by the share that taking had since the rest before."""
        now_ns = time.monotonic_ns()
        self._busy_ns += now_ns - begun_ns
        if left:
            return 0.0
        flooded = self._busy_ns > FLOODED_SHARE * (now_ns - self._rested_ns)
        self._busy_ns, self._rested_ns = 0, now_ns
        return min(self._rest_s, FLOOD_REST_S) if flooded else self._rest_s

    def _look_at(self, ready: list[tuple[int, int]], end: int) -> bool:
        left = False
        for fd, _ in ready:
            source = self._members.get(fd)
            if source is not None:
                left |= source.look()
            if self._is_closed():
                return False
            if time.monotonic_ns() > end:
                return True
        return left
