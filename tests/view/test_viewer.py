"""One connection against peers that leave in the middle; what waits for a viewer is bounded."""

from __future__ import annotations

import asyncio
import gc
import json
import logging
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from websockets.frames import Close, Frame, Opcode

from robotctl.view.viewer import (
    BINARY,
    MAX_BYTES,
    MAX_CONTROL_BYTES,
    PIECE_BYTES,
    Outbox,
    OverfullOutbox,
    frame_head,
)
from tests.support.view_client import STRING, TOKEN, Served, served
from tests.support.waiting import loop_until
from tests.view.test_server import handshake_request

RESET = struct.pack("ii", 1, 0)
"""SO_LINGER, with which a close sends a reset."""


@asynccontextmanager
async def raw_client(view: Served) -> AsyncIterator[socket.socket]:
    """Connect a socket whose handshake is done."""
    loop = asyncio.get_running_loop()
    with socket.create_connection(("127.0.0.1", view.port)) as sock:
        sock.setblocking(False)
        await loop.sock_sendall(sock, handshake_request(f"127.0.0.1:{view.port}", None, TOKEN))
        await loop.sock_recv(sock, 4096)
        yield sock


def frame(opcode: Opcode, data: bytes, *, fin: bool = True) -> bytes:
    """Return a frame of a client."""
    return Frame(opcode, data, fin).serialize(mask=True)


async def test_a_reset_in_the_middle_of_a_message_is_no_line_in_the_terminal(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """asyncio warns of each further write to a socket that the peer has reset."""
    async with served() as view:
        subscribed: list[int] = []
        view.server.on_subscribed = subscribed.append
        channel = view.server.offer("/a", *STRING)
        wanted = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]}
        async with raw_client(view) as sock:
            sock.send(frame(Opcode.TEXT, json.dumps(wanted).encode()))
            await loop_until(lambda: subscribed)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        view.server.publish(channel, 1, bytes(50 * PIECE_BYTES))
        await loop_until(lambda: not view.server._viewers)
    assert [each for each in caplog.records if each.levelno >= logging.WARNING] == []


async def test_a_stalled_viewer_that_leaves_gets_what_waits_and_the_end_of_the_handshake(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The connection ends once, after the answer to its close frame."""
    loop = asyncio.get_running_loop()
    async with served() as view, raw_client(view) as sock:
        (viewer,) = view.server._viewers
        while not viewer.is_stalled:
            viewer.tell(bytes(PIECE_BYTES))
        leave = Close(1000, "").serialize()
        await loop.sock_sendall(sock, frame(Opcode.CLOSE, leave))
        await loop_until(lambda: viewer._ends)
        got = b""
        while piece := await loop.sock_recv(sock, 1 << 20):
            got = (got + piece)[-100:]
        assert got.endswith(Frame(Opcode.CLOSE, leave).serialize(mask=False))
        await loop_until(lambda: not view.server._viewers)
    assert [each for each in caplog.records if each.levelno >= logging.WARNING] == []


async def test_the_pieces_of_a_message_hold_no_more_than_their_bytes() -> None:
    before = _frames_in_memory()
    async with served() as view, raw_client(view) as sock:
        loop = asyncio.get_running_loop()
        pieces = frame(Opcode.TEXT, b"{", fin=False) + 5_000 * frame(Opcode.CONT, b"", fin=False)
        await loop.sock_sendall(sock, pieces + frame(Opcode.PING, b"all is sent"))
        answer = b""
        while b"all is sent" not in answer:
            answer += await loop.sock_recv(sock, 4096)
        assert _frames_in_memory() - before < 100
        await loop.sock_sendall(sock, frame(Opcode.CONT, b"}"))
        while b"a message without an operation" not in answer:
            answer += await loop.sock_recv(sock, 4096)


def _frames_in_memory() -> int:
    """Return how many there are, those of earlier tests included."""
    return sum(type(each) is Frame for each in gc.get_objects())


def drained(outbox: Outbox) -> bytes:
    return b"".join(iter(outbox.take, b""))


@pytest.mark.parametrize("length", [0, 125, 126, 65_535, 65_536, 1 << 20])
def test_heads_of_frames_are_those_of_the_websocket_library(length: int) -> None:
    data = bytes(length)
    whole = Frame(Opcode.BINARY, data).serialize(mask=False)
    assert frame_head(BINARY, length) + data == whole


def test_the_bytes_that_wait_are_bounded_but_one_large_message_may_wait() -> None:
    outbox = Outbox()
    for _ in range(10):
        outbox.put_message(b"h", bytes(MAX_BYTES // 4))
    assert outbox.dropped == 6
    outbox = Outbox()
    for content in (b"x", b"y", b"z"):
        outbox.put_message(b"h", content * (8 * MAX_BYTES))
    assert outbox.dropped == 2
    assert drained(outbox) == b"h" + b"z" * (8 * MAX_BYTES)


def test_images_drop_no_small_messages() -> None:
    outbox = Outbox()
    for _ in range(3):
        outbox.put_message(b"h", b"image" * MAX_BYTES)
        outbox.put_message(b"h", b"odometry")
    assert outbox.dropped == 2
    assert drained(outbox).startswith(3 * b"hodometry" + b"himage")


def test_nothing_comes_between_the_pieces_of_a_frame() -> None:
    outbox = Outbox()
    outbox.put_message(b"h", b"x" * (2 * PIECE_BYTES))
    taken = outbox.take()
    outbox.put_control(b"c" * (PIECE_BYTES + 1))
    outbox.put_message(b"h", b"y")
    taken += drained(outbox)
    assert taken == b"h" + b"x" * (2 * PIECE_BYTES) + b"c" * (PIECE_BYTES + 1) + b"hy"


def test_offers_and_answers_are_never_dropped_but_bounded() -> None:
    outbox = Outbox()
    outbox.put_control(bytes(MAX_CONTROL_BYTES))
    with pytest.raises(OverfullOutbox):
        outbox.put_control(b"x")


def test_one_offer_above_the_limit_may_wait_alone() -> None:
    """Else no viewer could connect where there are thousands of topics."""
    outbox = Outbox()
    outbox.put_control(bytes(2 * MAX_CONTROL_BYTES))
    with pytest.raises(OverfullOutbox):
        outbox.put_control(b"x")
    outbox.take()
    outbox.put_control(b"x")
    assert len(drained(outbox)) == 2 * MAX_CONTROL_BYTES - PIECE_BYTES + 1
