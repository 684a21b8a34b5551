"""Requests that wait for their reply, and drives that wait for their end."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TypeVar

from robotctl.kernel.types import DriveEnded, Reply


@dataclass(frozen=True, slots=True)
class UnsavedReply(Reply):
    """The reply to a stop that happened but could not be saved: a restart would forget it."""


T = TypeVar("T", Reply, DriveEnded)


class PendingRequests:
    """The futures by request id; used in the loop's thread only."""

    def __init__(self) -> None:
        self._last_id = 0
        self._replies: dict[int, asyncio.Future[Reply]] = {}
        self._ends: dict[int, asyncio.Future[DriveEnded]] = {}
        self._replies_now: dict[int, Reply | None] = {}
        self._at_once: dict[int, Reply] = {}

    def new_id(self) -> int:
        """Return a new request id."""
        self._last_id += 1
        return self._last_id

    def expect_reply(self, request_id: int) -> asyncio.Future[Reply]:
        """Return the future of the one reply to a request."""
        return _expect(self._replies, request_id)

    def expect_reply_now(self, request_id: int) -> None:
        """Keep the reply to a request for `reply_now`: its caller does not wait."""
        self._replies_now[request_id] = None

    def keep_now(self, reply: Reply) -> bool:
        """Keep the reply to a request that waits in `reply_now`; return False if none does."""
        if reply.request_id not in self._replies_now:
            return False
        self._replies_now[reply.request_id] = reply
        return True

    def reply_now(self, request_id: int) -> Reply:
        """Return the reply that was kept."""
        reply = self._replies_now.pop(request_id)
        assert reply is not None, "the request was dispatched while another event was handled"
        return reply

    def expect_end(self, request_id: int) -> asyncio.Future[DriveEnded]:
        """Return the future of the end of the drive that a request will start."""
        return _expect(self._ends, request_id)

    def answer(self, reply: Reply) -> None:
        """Set the future of a reply, if there is one."""
        _settle(self._replies, reply)

    def end_drive(self, ended: DriveEnded) -> None:
        """Set the future of the end of a drive, if there is one."""
        _settle(self._ends, ended)


def _expect(waiting: dict[int, asyncio.Future[T]], request_id: int) -> asyncio.Future[T]:
    future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
    waiting[request_id] = future
    future.add_done_callback(lambda _: waiting.pop(request_id, None))
    return future


def _settle(waiting: dict[int, asyncio.Future[T]], result: T) -> None:
    future = waiting.get(result.request_id)
    if future is not None and not future.done():
        future.set_result(result)
