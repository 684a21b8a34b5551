"""An event loop with cheap wake-ups, the beat of timers, and time limits."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine
from contextvars import copy_context
from functools import partial
from select import EPOLLIN, EPOLLOUT
from selectors import EVENT_READ, EVENT_WRITE, EpollSelector, SelectorKey
from typing import Any, Final, TypeVar

NS_PER_S = 1_000_000_000

SLOW_CALLBACK_NS = 50_000_000
"""The longest time that a callback may block the loop without a warning."""

SLOW_WARNING_PAUSE_NS = 10_000_000_000
"""The least time between two warnings about the same callback."""

SLICE_NS = 300_000
"""The longest time for the messages of one entity before others get their turn."""

TURN_NS = 1_000_000
"""The time for all entities in a flood of messages together, in one turn of the loop."""

SHORTEST_SLICE_NS = 50_000
"""The shortest time slice in a flood, because a change of entity costs time too."""

FLOOD_REST_S = 0.002
"""How long the messages of a subscription are collected in a flood."""

FLOODED_SHARE = 0.1
"""The busy share of time above which a `Pool` is in a flood (10 to 20 kHz of messages)."""

FASTEST_TOPIC_HZ = 50_000.0
"""The highest expected rate of a topic."""

POLLS_PER_RATE_CHECK = 32
"""The number of polls between two checks of a subscription's rate."""

FLOODED_WITHIN_NS = 16_000_000
"""A flood begins if POLLS_PER_RATE_CHECK polls took less time (over 2 kHz)."""

CALM_BEYOND_NS = 64_000_000
"""A flood ends if POLLS_PER_RATE_CHECK polls took more time (under 500 Hz)."""


BEAT_NS = 20_000_000
"""The time between two beats, 50 a second, on which timers expire together."""

_START_NS = time.monotonic_ns()
"""The first beat, which differs between processes so that not all of them wake up together."""


def beat_before(t_ns: int, period_ns: int = BEAT_NS) -> int:
    """Return the last beat [ns] up to steady time `t_ns`. Beats wake timers every `period_ns`."""
    return t_ns - (t_ns - _START_NS) % period_ns


_MS_PER_S: Final = 1000
"""epoll waits for whole milliseconds."""

_MOST_AT_ONCE: Final = 64
"""Limit on the descriptors of one turn. Linux returns the others in the next turn."""

T = TypeVar("T")


class _CallingSelector(EpollSelector):
    """A selector that runs the callbacks of `calls`, and returns the other ready descriptors."""

    def __init__(self) -> None:
        super().__init__()
        self._epoll: Any = self._selector  # type: ignore[attr-defined]
        self.calls: dict[int, Callable[[], object]] = {}
        self.on_error: Callable[[BaseException], None]

    def watch(self, fd: int, call: Callable[[], object]) -> None:
        self._epoll.register(fd, EPOLLIN)
        self.calls[fd] = call

    def unwatch(self, fd: int) -> None:
        if self.calls.pop(fd, None) is not None:
            self._epoll.unregister(fd)

    def close(self) -> None:
        self.calls.clear()
        super().close()

    def select(self, timeout: float | None = None) -> list[tuple[SelectorKey, int]]:
        # Rounded up, as in the base class: rounded down, the loop would spin until a timer is due.
        wait_s = -1 if timeout is None else math.ceil(timeout * _MS_PER_S) / _MS_PER_S
        others = []
        for fd, event in self._epoll.poll(wait_s, _MOST_AT_ONCE):
            call = self.calls.get(fd)
            if call is None:
                others.append((fd, event))
                continue
            try:
                call()
            except (SystemExit, KeyboardInterrupt):
                raise
            except BaseException as error:  # noqa: BLE001 - as a handle of asyncio does
                self.on_error(error)
        if not others:
            return []
        # Looked up only now: a callback may have changed what asyncio watches.
        keyed = self.get_map()
        keys = ((keyed.get(fd), event) for fd, event in others)
        return [(key, _mask(event) & key.events) for key, event in keys if key is not None]


def _mask(event: int) -> int:
    """Convert an epoll event mask to a selector's. An error counts as readable and writable."""
    readable = EVENT_READ if event & ~EPOLLOUT else 0
    return readable | (EVENT_WRITE if event & ~EPOLLIN else 0)


class EventLoop(asyncio.SelectorEventLoop):
    """An asyncio loop with cheaper wake-ups for an `AsyncioExecutor`."""

    def __init__(self) -> None:
        self._calling = _CallingSelector()
        self._calling.on_error = self._report
        super().__init__(self._calling)

    def watch(self, fd: int, callback: Callable[[], object]) -> None:
        """Call `callback` in each turn in which `fd` is readable, before asyncio's callbacks."""
        self._calling.watch(fd, partial(copy_context().run, callback))

    def unwatch(self, fd: int) -> None:
        """Stop watching `fd`, which must still be open. An `fd` that is not watched is ignored."""
        self._calling.unwatch(fd)

    def _report(self, error: BaseException) -> None:
        context = {"message": "exception in the callback of a descriptor", "exception": error}
        self.call_exception_handler(context)


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine as `asyncio.run` does, in an `EventLoop`."""
    with asyncio.Runner(loop_factory=EventLoop) as runner:
        return runner.run(main)


def watch(loop: asyncio.AbstractEventLoop, fd: int, callback: Callable[[], object]) -> None:
    """Call `callback` in `loop`, an asyncio loop of any class, whenever `fd` is readable."""
    if isinstance(loop, EventLoop):
        loop.watch(fd, callback)
    else:
        loop.add_reader(fd, callback)


def unwatch(loop: asyncio.AbstractEventLoop, fd: int) -> None:
    """Stop watching `fd` in `loop`. A closed loop is ignored."""
    if isinstance(loop, EventLoop):
        loop.unwatch(fd)
    elif not loop.is_closed():
        loop.remove_reader(fd)
