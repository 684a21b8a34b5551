"""Waiting for a socket in the loop, and asking it now."""

from __future__ import annotations

import asyncio
import select
import socket


async def until_readable(sock: socket.socket) -> None:
    """Wait until there is something to read or to accept.

    Nothing is taken from the socket: unlike with `loop.sock_recv` and `loop.sock_accept`, what
    arrives as the waiting task is cancelled is not lost.
    """
    loop = asyncio.get_running_loop()
    readable = loop.create_future()
    loop.add_reader(sock, _wake, readable)
    try:
        await readable
    finally:
        loop.remove_reader(sock)


def is_readable(sock: socket.socket) -> bool:
    """Whether there is something to read now, or the end of the stream."""
    return _has(sock, select.POLLIN)


def is_hung_up(sock: socket.socket) -> bool:
    """Whether the other end is closed in both directions."""
    return _has(sock, 0)


def _wake(waiting: asyncio.Future[None]) -> None:
    if not waiting.done():
        waiting.set_result(None)


def _has(sock: socket.socket, events: int) -> bool:
    poll = select.poll()
    poll.register(sock, events)
    return bool(poll.poll(0))
