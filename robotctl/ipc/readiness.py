"""Wait for a socket in the loop, or check its state now."""

from __future__ import annotations

import asyncio
import select
import socket


async def until_readable(sock: socket.socket) -> None:
    """Wait until the socket has data, or a client to accept.

    Nothing is read from the socket. So no data is lost if the waiting task is cancelled just as
    data arrives, as it would be with `loop.sock_recv` and `loop.sock_accept`.
    """
    loop = asyncio.get_running_loop()
    readable = loop.create_future()
    loop.add_reader(sock, _wake, readable)
    try:
        await readable
    finally:
        loop.remove_reader(sock)


def is_readable(sock: socket.socket) -> bool:
    """Return whether the socket has data, or has reached the end of the stream."""
    return _has(sock, select.POLLIN)


def is_hung_up(sock: socket.socket) -> bool:
    """Return whether the other end is closed in both directions."""
    return _has(sock, 0)


def _wake(waiting: asyncio.Future[None]) -> None:
    if not waiting.done():
        waiting.set_result(None)


def _has(sock: socket.socket, events: int) -> bool:
    poll = select.poll()
    poll.register(sock, events)
    return bool(poll.poll(0))
