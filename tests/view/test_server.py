"""The server of the view, by a client of the protocol over real sockets."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import random
import socket
from contextlib import suppress
from unittest.mock import Mock

import pytest
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from robotctl.base.errors import Refused
from robotctl.view.foxglove import Offer
from robotctl.view.server import MAX_OFFERS, ViewServer, listening_socket
from robotctl.view.viewer import MAX_REQUEST_BYTES, Admission, new_token
from tests.support.view_client import STRING, TOKEN, Served, ViewClient, served, view_client
from tests.support.waiting import loop_until

SERVER = "robotctl.view.server"


@pytest.mark.parametrize("subprotocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
async def test_a_viewer_gets_the_messages_it_subscribes_to(subprotocol: str) -> None:
    async with served() as view, view_client(view.url, subprotocol=subprotocol) as client:
        assert client.socket.subprotocol == subprotocol
        a, b = view.server.offer("/a", *STRING), view.server.offer("/b", *STRING)
        await client.subscribe("/a")
        await in_order(client)
        view.server.publish(b, 1, b"unwanted")
        view.server.publish(a, 2, b"wanted")
        view.server.publish(a, 3, memoryview(bytes(3_000_000)))
        await client.until(lambda: len(client.messages) == 2)
        assert [(each.log_ns, len(each.data)) for each in client.of("/a")] == [
            (2, 6),
            (3, 3_000_000),
        ]
        assert client.channels["/a"]["schemaName"] == "std_msgs/msg/String"
        assert client.channels["/a"]["schemaEncoding"] == "ros2msg"
        assert client.op("serverInfo")[0]["capabilities"] == []
        await client.unsubscribe("/a")
        await in_order(client)
        view.server.publish(a, 4, b"late")
        view.server.withdraw(b)
        await client.until(lambda: client.op("unadvertise"))
        assert len(client.messages) == 2


async def in_order(client: ViewClient) -> None:
    """Wait until the server has taken all earlier requests."""
    count = len(client.op("status"))
    await client.ask(op="nonsense")
    await client.until(lambda: len(client.op("status")) > count)


async def test_it_tells_when_a_topic_begins_and_ends_to_be_watched() -> None:
    async with served() as view:
        watched: list[tuple[str, int]] = []
        view.server.on_subscribed = lambda channel: watched.append(("on", channel))
        view.server.on_unwatched = lambda channel: watched.append(("off", channel))
        a = view.server.offer("/a", *STRING)
        async with view_client(view.url) as one:
            await one.subscribe("/a")
            async with view_client(view.url) as two:
                await two.subscribe("/a")
                await loop_until(lambda: len(watched) == 2)
            await one.unsubscribe("/a")
            await loop_until(lambda: ("off", a) in watched)
    assert watched == [("on", a), ("on", a), ("off", a)]


async def test_a_view_is_read_only() -> None:
    """What would publish, set or call is refused, and the connection goes on."""
    async with served() as view, view_client(view.url) as client:
        requests: list[str | bytes] = [
            json.dumps({"op": "advertise", "channels": [{"id": 1, "topic": "/cmd_vel"}]}),
            json.dumps({"op": "setParameters", "parameters": []}),
            json.dumps({"op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1}),
            b"\x01" + bytes(8),
            b"\x02" + bytes(12),
            b"\x03" + bytes(2) + b"\x80\x3f" + bytes(13),
        ]
        for request in requests:
            await client.socket.send(request)
        await client.until(lambda: len(client.op("status")) == len(requests))


async def test_none_of_200_foreign_pages_rebound_names_and_old_tokens_gets_through() -> None:
    chance = random.Random(16)
    async with served() as view:
        own, old = f"127.0.0.1:{view.port}", new_token()
        for number in range(200):
            host, origin, token = own, None, TOKEN
            kind = number % 3
            if kind == 0:
                origin = f"http://{chance.choice(['evil.example', 'localhost:3000', '10.0.0.1'])}"
            elif kind == 1:
                host = f"{chance.choice(['evil', 'a.localhost', '127.0.0.1'])}.example:{view.port}"
            else:
                token = chance.choice([old, "", TOKEN[:-1], TOKEN.upper(), TOKEN + "0"])
            assert b" 101 " not in await handshake(view, host, origin, token), number
        assert b" 101 " in await handshake(view, own, None, TOKEN)


async def handshake(view: Served, host: str, origin: str | None, token: str) -> bytes:
    """Return the first line of the answer."""
    reader, writer = await asyncio.open_connection("127.0.0.1", view.port)
    writer.write(handshake_request(host, origin, token))
    first = await reader.readline()
    writer.close()
    return first


def handshake_request(host: str, origin: str | None, token: str) -> bytes:
    """Return the first request of a connection."""
    lines = [
        f"GET /?token={token} HTTP/1.1",
        f"Host: {host}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: foxglove.sdk.v1",
        *([f"Origin: {origin}"] if origin else []),
    ]
    return "\r\n".join([*lines, "", ""]).encode()


async def test_a_client_without_one_of_the_protocols_is_refused() -> None:
    async with served() as view:
        with pytest.raises(InvalidHandshake):
            async with view_client(view.url, subprotocol="chat"):
                pass


async def test_a_stalled_viewer_loses_its_oldest_messages_and_is_told() -> None:
    async with served() as view:
        channel = view.server.offer("/a", *STRING)
        async with view_client(view.url) as slow, view_client(view.url) as quick:
            for client in (slow, quick):
                await client.subscribe("/a")
                await in_order(client)
            slow.socket.transport.pause_reading()
            sent = 0
            (viewer,) = (each for each in view.server._viewers if _is_of(each, slow))
            while viewer.outbox.dropped < 100:
                view.server.publish(channel, sent, bytes(10_000))
                sent += 1
                await quick.until(lambda: len(quick.messages) == sent)  # noqa: B023 - awaited here
            last = sent - 1
            slow.socket.transport.resume_reading()
            await slow.until(lambda: slow.messages and slow.messages[-1].log_ns == last)
            await slow.until(lambda: slow.op("status")[-1].get("id") == "dropped")
            assert len(slow.messages) + viewer.outbox.dropped == sent
            assert f"{viewer.outbox.dropped} messages" in slow.op("status")[-1]["message"]
            assert all(each.get("id") != "dropped" for each in quick.op("status"))


def _is_of(viewer: object, client: ViewClient) -> bool:
    """Return whether a viewer is the other end of a client."""
    transport = viewer._transport  # type: ignore[attr-defined]
    ours = client.socket.transport.get_extra_info("sockname")
    return bool(transport.get_extra_info("peername") == ours)


async def test_a_viewer_that_takes_nothing_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{SERVER}.STALL_S", 0.1)
    monkeypatch.setattr(f"{SERVER}.PERIOD_S", 0.05)
    async with served() as view, view_client(view.url) as client:
        gone: list[int] = []
        channel = view.server.offer("/a", *STRING)
        await client.subscribe("/a")
        await in_order(client)
        view.server.on_unwatched = gone.append
        client.socket.transport.pause_reading()
        while not gone:
            view.server.publish(channel, 1, bytes(100_000))
            await asyncio.sleep(0)
        assert gone == [channel]
        client.socket.transport.abort()


async def test_a_handshake_that_does_not_end_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{SERVER}.HANDSHAKE_S", 0.1)
    monkeypatch.setattr(f"{SERVER}.PERIOD_S", 0.05)
    async with served() as view:
        reader, writer = await asyncio.open_connection("127.0.0.1", view.port)
        writer.write(b"GET / HTTP/1.1\r\nHost: ")
        with suppress(ConnectionError):
            assert await reader.read() == b""
        writer.close()


@pytest.mark.parametrize(
    "sent",
    [
        *(b"\x16\x03\x01\x02\x00\x01", b"GET / HTTP/1.1\r\n\r\n", b"x" * 20_000, b"\r\n\r\n"),
        handshake_request("127.0.0.1", None, "wrong") + b"no frame",
        handshake_request("127.0.0.1", None, TOKEN) + b"no frame",
    ],
)
async def test_what_is_no_handshake_is_answered_or_ended(
    sent: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async with served() as view:
        reader, writer = await asyncio.open_connection("127.0.0.1", view.port)
        writer.write(sent)
        writer.write_eof()
        with suppress(ConnectionError):
            assert b" 101 " not in await reader.read()
        writer.close()
        async with view_client(view.url) as client:
            await client.until(lambda: client.op("serverInfo"))
    assert not caplog.messages


async def test_a_connection_above_the_limit_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{SERVER}.MAX_CONNECTIONS", 1)
    async with served() as view, view_client(view.url) as first:
        reader, writer = await asyncio.open_connection("127.0.0.1", view.port)
        async with asyncio.timeout(2.0):  # a handshake may take 5 s
            with suppress(ConnectionError):
                assert await reader.read() == b""
        writer.close()
        await in_order(first)


async def test_a_viewer_told_to_leave_gets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{SERVER}.MAX_VIEWERS", 0)
    async with served() as view:
        subscribed: list[int] = []
        view.server.on_subscribed = subscribed.append
        channel = view.server.offer("/a", *STRING)
        text = json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]})
        subscribe = bytes((0x81, 0x80 | len(text), 0, 0, 0, 0)) + text.encode()
        reader, writer = await asyncio.open_connection("127.0.0.1", view.port)
        request = handshake_request(f"127.0.0.1:{view.port}", None, TOKEN)
        writer.write(request + subscribe)
        answer = await reader.readuntil(b"are connected already")
        assert answer.startswith(b"HTTP/1.1 101 ")
        assert subscribed == []
        writer.close()


async def test_a_request_that_is_too_large_ends_only_its_connection() -> None:
    async with served() as view, view_client(view.url) as other:
        async with view_client(view.url) as client:
            await client.socket.send(b" " * (MAX_REQUEST_BYTES + 1))
            with pytest.raises(ConnectionClosed):
                await client.until(lambda: False)
        await in_order(other)


async def test_a_later_viewer_sees_the_notes_that_still_hold() -> None:
    async with served() as view:
        view.server.note("/x", "/x is not shown")
        view.server.note("/y", "/y is not shown")
        async with view_client(view.url) as client:
            await client.until(lambda: len(client.op("status")) == 2)
            view.server.note("/x", "")
            await client.until(lambda: client.op("removeStatus"))
            assert client.op("removeStatus")[0]["statusIds"] == ["/x"]
        async with view_client(view.url) as client:
            await in_order(client)
            assert client.op("status")[0]["message"] == "/y is not shown"


async def test_the_channels_that_a_viewer_offers_are_bounded() -> None:
    async with served() as view, view_client(view.url) as client:
        offered: list[Offer] = []
        view.server.on_offer = offered.append
        channel = {"topic": "/x", "encoding": "json", "schemaName": "x"}
        channels = [{"id": number, **channel} for number in range(MAX_OFFERS + 1)]
        await client.ask(op="advertise", channels=channels)
        await client.until(lambda: client.op("status"))
        assert f"{MAX_OFFERS} channels" in client.op("status")[0]["message"]
        (viewer,) = view.server._viewers
        assert len(viewer.offers) == MAX_OFFERS


async def test_a_port_that_is_taken_is_named_and_the_usual_one_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        monkeypatch.setattr(f"{SERVER}.DEFAULT_PORT", port)
        server = ViewServer("test", Admission(TOKEN))
        with pytest.raises(Refused, match=f"port {port}.*--port"):
            await server.listen("127.0.0.1", port)
        assert await server.listen("127.0.0.1", None) != port
        server.close()


@pytest.mark.parametrize("host", ["192.0.2.1", "no-such-name.invalid", "..", "a" * 70, ""])
@pytest.mark.parametrize("port", [None, 0])
def test_a_host_of_another_computer_is_named_with_its_option(host: str, port: int | None) -> None:
    with pytest.raises(Refused, match=r"cannot listen on .*--host") as caught:
        listening_socket(host, port)
    assert repr(host) in str(caught.value)
    assert "port" not in str(caught.value)


def test_a_kernel_without_ipv6_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))
    monkeypatch.setattr(socket, "socket", Mock(side_effect=absent))
    with pytest.raises(Refused, match=os.strerror(errno.EAFNOSUPPORT)):
        listening_socket("::1", None)


def test_no_other_process_gets_the_port_before_the_view_accepts() -> None:
    """A port that is only bound can be bound twice, and the second view would fail at `listen`."""
    with listening_socket("127.0.0.1", 0) as first, socket.socket() as other:
        port = first.getsockname()[1]
        with pytest.raises(Refused, match=os.strerror(errno.EADDRINUSE)):
            listening_socket("127.0.0.1", port)
        other.connect(("127.0.0.1", port))
