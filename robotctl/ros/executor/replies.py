# mypy: disallow-untyped-calls=False
"""Holds a service's response back until the client's reader of responses is discovered.

To a reader that is not discovered, rmw_fastrtps would block for 0.1 s and drop the response.
"""

from __future__ import annotations

import ctypes
import warnings
from asyncio import TimerHandle
from collections import deque
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Final

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier

from robotctl.ros.executor.runtime import Runtime, log

WAIT_S: Final = 5.0
"""How long a response waits for its reader before it is dropped."""

MAX_WAITING: Final = 100
"""Limit on the waiting responses of one service. Above it, the oldest is dropped."""

POLL_S: Final = 0.02
"""The time between two looks for readers, which no callback announces."""

PAUSE_S: Final = 1.0
"""The least time between two failing attempts to reach a reader. Each blocks the loop for 0.1 s."""

MAX_KNOWN: Final = 1_000
"""Limit on the remembered readers, which need no look at the graph."""

_GID_BYTES: Final = 16
_READER_BIT: Final = 0x04
"""Set in the last byte of the gids of readers, not of writers (DDSI-RTPS 2.5, 9.3.1.2)."""


@dataclass(slots=True)
class _Waiting:
    """A response that waits for the reader `gid`, at most until the loop's time `until_s` [s]."""

    gid: bytes
    attempt: Callable[[], bool]
    until_s: float


class Replies:
    """Sends each response once its client's reader is discovered. For the loop's thread only."""

    def __init__(
        self, runtime: Runtime, where: str, readers: Callable[[], Container[bytes]]
    ) -> None:
        """`readers()` returns the gids of the discovered readers of the service's responses."""
        self._runtime = runtime
        self._where = where
        self._readers = readers
        self._known: set[bytes] = set()
        """Readers to which a response was sent."""
        self._paused: dict[bytes, float] = {}
        """Reader to which sending failed -> the loop's time [s] until which sending pauses."""
        self._waiting: deque[_Waiting] = deque()
        self._timer: TimerHandle | None = None
        self._closed = False

    def send(self, header: Any, attempt: Callable[[], bool]) -> None:
        """Call `attempt`, which sends a response, as soon as the client's reader is discovered.

        `header` belongs to the request. `attempt` returns whether the middleware accepted the
        response, and is repeated after a failure, for WAIT_S at most.
        """
        gid = reader_of(header)
        if gid is None or self._closed:
            attempt()
            return
        now_s = self._runtime.loop.time()
        ready = gid in self._known or (not self._is_paused(gid, now_s) and gid in self._readers())
        if not ready or not self._succeeds(gid, attempt, now_s):
            self._keep(_Waiting(gid, attempt, now_s + WAIT_S))

    def close(self) -> None:
        """Drop the responses that wait for a reader. Afterwards `send` tries each response once."""
        self._closed = True
        self._waiting.clear()
        if self._timer is not None:
            self._timer.cancel()

    def _is_paused(self, gid: bytes, now_s: float) -> bool:
        return self._paused.get(gid, now_s) > now_s

    def _succeeds(self, gid: bytes, attempt: Callable[[], bool], now_s: float) -> bool:
        if attempt():
            if len(self._known) >= MAX_KNOWN:
                self._known.clear()
            self._known.add(gid)
            return True
        self._known.discard(gid)
        self._paused[gid] = now_s + PAUSE_S
        return False

    def _keep(self, each: _Waiting) -> None:
        if len(self._waiting) >= MAX_WAITING:
            self._waiting.popleft()
            log.warning("%s: a response was dropped: more than %d wait", self._where, MAX_WAITING)
        self._waiting.append(each)
        self._look_later()

    def _look_later(self) -> None:
        if self._timer is None and self._waiting:
            self._timer = self._runtime.loop.call_later(POLL_S, self._look)

    def _look(self) -> None:
        self._timer = None
        now_s = self._runtime.loop.time()
        waiting, self._waiting = self._waiting, deque()
        readers = self._readers()
        blocked = False
        for each in waiting:
            if now_s >= each.until_s:
                log.warning(
                    "%s: a response was dropped: its client could not be reached for %g s",
                    self._where,
                    WAIT_S,
                )
            elif blocked or self._is_paused(each.gid, now_s) or each.gid not in readers:
                self._waiting.append(each)
            else:
                try:
                    blocked = not self._succeeds(each.gid, each.attempt, now_s)
                except Exception as error:  # noqa: BLE001 - goes to the exception handler
                    self._runtime.report(error, self._where)
                if blocked:  # the attempt blocked the loop for 0.1 s: no other in this turn
                    self._waiting.append(each)
        if not self._waiting:
            self._paused.clear()
        self._look_later()


class _Everything:
    """A container that contains every gid."""

    def __contains__(self, gid: object) -> bool:
        return True


def readers_of(node: Node, service: str) -> Callable[[], Container[bytes]]:
    """Return a function that lists the discovered readers of a service's responses.

    `service` is the full name. If the list cannot be read, every reader counts as discovered.
    """
    topic = f"rr{service}Reply"

    def readers() -> Container[bytes]:
        try:
            with node.handle:
                found = _rclpy.rclpy_get_subscriptions_info_by_topic(node.handle, topic, True)
        except (UnicodeDecodeError, InvalidHandle):
            return _Everything()
        return {bytes(each["endpoint_gid"]) for each in found}

    return readers


def reader_of(header: Any) -> bytes | None:
    """Return the gid of the client's reader of responses from a request's header, or None."""
    if isinstance(header, _rclpy.rmw_service_info_t):
        header = header.request_id
    is_fastrtps = "fastrtps" in get_rmw_implementation_identifier()
    if not is_fastrtps or not isinstance(header, _rclpy.rmw_request_id_t):
        return None
    # rclpy hides the gid, which precedes the sequence number in rmw_request_id_t. So read the C
    # structure, whose address a pybind11 object has behind its Python header.
    address = ctypes.c_void_p.from_address(id(header) + object.__basicsize__).value
    raw = ctypes.string_at(address, _GID_BYTES + 8) if address else b""
    gid, sequence = raw[:_GID_BYTES], raw[_GID_BYTES:]
    if int.from_bytes(sequence, "little", signed=True) != header.sequence_number:
        return None
    return gid if gid[-1] & _READER_BIT else None


def is_taken(send: Callable[[], None]) -> bool:
    """Call `send`, and return whether the middleware accepted the response."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        send()
    return not any(issubclass(each.category, RuntimeWarning) for each in warned)


_REQUESTER: ContextVar[bytes | None] = ContextVar("requester", default=None)


def requester() -> bytes | None:
    """Return the gid of the client whose request or goal the caller handles.

    The gid (16 bytes) is that of the client's reader of responses. It is None outside a handler, or
    if the middleware does not report it.
    """
    return _REQUESTER.get()


@contextmanager
def request_of(header: Any) -> Iterator[None]:
    """Make `requester()` return the gid of the client that sent `header`, in the `with` block."""
    token = _REQUESTER.set(reader_of(header))
    try:
        yield
    finally:
        _REQUESTER.reset(token)
