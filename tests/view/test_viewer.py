"""One connection against peers that leave in the middle; what waits for a viewer is bounded.

What viewers ask of the robot, and a view without a free descriptor.
Who may connect: the right token, a Host that nobody else controls, and a known page or none.
The bytes of the protocol are those of Foxglove's own SDK; requests are decoded strictly.
"""

from __future__ import annotations

import asyncio
import errno
import gc
import json
import logging
import resource
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.frames import Close, Frame, Opcode

from robotctl.base.errors import UsageError
from robotctl.cli.commands.status import view
from robotctl.view.foxglove import (
    ClientMessage,
    ClientOffers,
    ClientWithdrawal,
    Offer,
    Subscribe,
    Unsubscribe,
    WrongRequest,
    binary_request,
    message_head,
    text_request,
)
from robotctl.view.remote_control import MAX_CALLS, SERVICES, STOP, RemoteControl, velocity_of
from robotctl.view.serving import loop_failures
from robotctl.view.view_job import is_origin
from robotctl.view.viewer import (
    BINARY,
    KNOWN_ORIGINS,
    MAX_BYTES,
    MAX_CONTROL_BYTES,
    PIECE_BYTES,
    Admission,
    Outbox,
    OverfullOutbox,
    frame_head,
)
from tests.support.view_client import STRING, TOKEN, Served, served, view_client
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


NO_DAEMON = "no_daemon_has_this_name"


async def test_each_call_of_a_service_is_answered() -> None:
    """Also one of no such service, one with a body that is none, and one more than is allowed."""
    async with served(services=SERVICES) as view, view_client(view.url) as client:
        RemoteControl(NO_DAEMON, view.server, "")
        for call_id, service_id in enumerate([99, STOP.id, *[STOP.id] * MAX_CALLS[STOP.id]]):
            head = struct.pack("<BIII", 2, service_id, call_id, 4_000)
            await client.socket.send(head + b"no body")
        await client.until(lambda: client.responses and len(client.op("serviceCallFailure")) == 2)
        no_such, too_many = client.op("serviceCallFailure")
        assert (no_such["callId"], no_such["message"]) == (0, "there is no such service")
        assert too_many["callId"] == 2
        (answer,) = client.responses
        assert not answer["success"]
        assert "robotctl start" in answer["message"]


def test_a_twist_is_two_numbers() -> None:
    full = b'{"linear": {"x": 0.5, "y": 0, "z": 0.0}, "angular": {"x": 0, "y": 0, "z": -1}}'
    assert velocity_of(full) == (0.5, -1.0)
    assert velocity_of(b'{"linear": {"x": 0.5}, "angular": {"z": 0}}') == (0.5, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b'{"linear": {"x": NaN}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1e999}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1, "y": 0.1}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1}, "angular": {"x": 1, "z": 0}}',
        b'{"linear": {"x": "fast"}, "angular": {"z": 0}}',
        b'{"linear": 3, "angular": {"z": 0}}',
        b'{"linear": {"x": 1}}',
        b'{"linear": {"x": ' + b"9" * 400 + b'}, "angular": {"z": 0}}',
    ],
)
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(WrongRequest):
        velocity_of(data)


async def test_a_viewer_waits_until_a_descriptor_is_free(capfd: pytest.CaptureFixture[str]) -> None:
    asyncio.get_running_loop().set_exception_handler(loop_failures())
    said: list[str] = []

    def is_said() -> bool:
        said.append(capfd.readouterr().err)
        return "Too many open files" in "".join(said)

    async with served() as view:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        with socket.socket() as client:
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))  # with less, poll fails
            try:
                client.connect(("127.0.0.1", view.port))
                await loop_until(is_said)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            await loop_until(lambda: len(view.server._connections) == 1)
    assert "".join(said) == (
        "robotctl view: Too many open files: new viewers wait; raise the limit (ulimit -n), or "
        "close other viewers\n"
    )


OWN_TOKEN = "T0ken_of-this-run"
TARGET = f"/?token={OWN_TOKEN}"
HOST = "127.0.0.1:8765"
ADMISSION = Admission(OWN_TOKEN)


@pytest.mark.parametrize(
    "host", [HOST, "localhost:8765", "[::1]:8765", "192.168.1.7:9", f"{socket.gethostname()}:8765"]
)
@pytest.mark.parametrize("origins", [[], *([each] for each in KNOWN_ORIGINS)])
def test_known_pages_and_programs_are_admitted(host: str, origins: list[str]) -> None:
    assert ADMISSION.refusal(TARGET, [host], origins) == ""


@pytest.mark.parametrize(
    "hosts",
    [
        [],
        [HOST, HOST],
        [""],
        ["evil.example:8765"],
        ["localhost.evil.example"],
        ["127.0.0.1.evil.example:8765"],
        ["evil.example@127.0.0.1.x"],
        ["[::1"],
        ["127.1:8765"],
        ["2130706433:8765"],
    ],
)
def test_a_host_that_others_may_control_is_refused(hosts: list[str]) -> None:
    assert "Host" in ADMISSION.refusal(TARGET, hosts, [])


@pytest.mark.parametrize(
    "origins",
    [
        ["https://evil.example"],
        ["null"],
        ["http://app.foxglove.dev"],
        ["https://app.foxglove.dev.evil.example"],
        ["https://app.foxglove.dev", "https://evil.example"],
        ["http://localhost:3000"],
        [""],
    ],
)
def test_pages_of_other_origins_are_refused(origins: list[str]) -> None:
    assert "origin" in ADMISSION.refusal(TARGET, [HOST], origins)


def test_an_origin_of_the_user_is_admitted() -> None:
    own = Admission(OWN_TOKEN, ["https://lichtblick.example.org"])
    assert own.refusal(TARGET, [HOST], ["https://lichtblick.example.org"]) == ""


@pytest.mark.parametrize("host", ["127.1", "Robot.lan"])
def test_the_name_that_the_view_was_told_to_listen_on_is_admitted(host: str) -> None:
    """The URL that is printed has this name."""
    own = Admission(OWN_TOKEN, host=host)
    assert own.refusal(TARGET, [f"{host}:8765"], []) == ""
    assert "Host" in own.refusal(TARGET, [f"{host}.evil.example:8765"], [])


@pytest.mark.parametrize("origin", [*KNOWN_ORIGINS, "null", "app://x", "http://[::1]:8080"])
def test_what_a_browser_can_send_is_an_origin(origin: str) -> None:
    assert is_origin(origin)


@pytest.mark.parametrize(
    "text",
    [
        *("", "*", "x.org", "https://x.org/", "https://X.org", "https://*.org", "https://"),
        "https://a b",
    ],
)
def test_what_no_browser_sends_is_no_origin_and_refused_by_the_command(text: str) -> None:
    assert not is_origin(text)
    with pytest.raises(UsageError, match=r"--origin .* such as https://"):
        view(origin=["https://x.org", text])


@pytest.mark.parametrize(
    "target",
    [
        *("/", "/?token=", "/?token=T0ken_of-another", f"/?token={OWN_TOKEN[:-1]}"),
        *(
            f"/?token={OWN_TOKEN}x",
            f"/?token=other&token={OWN_TOKEN}",
            f"/?Token={OWN_TOKEN}",
            f"/{OWN_TOKEN}",
        ),
        *("/?token=%ff", "//["),
    ],
)
def test_a_url_without_the_token_of_this_run_is_refused(target: str) -> None:
    assert "token" in ADMISSION.refusal(target, [HOST], [])


# What foxglove-sdk 0.30.3 sends for the same values.
MESSAGE = "01 07 00 00 00 7b 00 00 00 00 00 00 00 00 01 00 00 68 65 6c 6c 6f"


def test_binary_messages_are_those_of_the_sdk() -> None:
    assert message_head(7, 123) + b"\x00\x01\x00\x00hello" == bytes.fromhex(MESSAGE)


def test_subscriptions_are_pairs_of_ids() -> None:
    text = b'{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 1}]}'
    assert text_request(text) == Subscribe({7: 1})
    text = b'{"op": "unsubscribe", "subscriptionIds": [7, 8]}'
    assert text_request(text) == Unsubscribe([7, 8])


def test_what_a_viewer_publishes_is_read() -> None:
    text = (
        b'{"op": "advertise", "channels": [{"id": 5, "topic": "/t", "encoding": "json",'
        b' "schemaName": "geometry_msgs/msg/Twist"}]}'
    )
    offer = Offer(5, "/t", "json", "geometry_msgs/msg/Twist")
    assert text_request(text) == ClientOffers([offer])
    assert binary_request(b"\x01\x05\0\0\0{}") == ClientMessage(5, b"{}")
    text = b'{"op": "unadvertise", "channelIds": [5]}'
    assert text_request(text) == ClientWithdrawal([5])


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{bad",
        b"[]",
        b"{}",
        b'{"op": "advertise", "channels": [{"id": 1}]}',
        b'{"op": "setParameters"}',
        b'{"op": "subscribe"}',
        b'{"op": "subscribe", "subscriptions": [3]}',
        b'{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}',
        b'{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        b'{"op": "subscribe", "subscriptions": [{"id": 1e400, "channelId": 1}]}',
        b"[" * 100_000,
        b'"\xff"',
    ],
)
def test_other_texts_are_refused_with_one_error(text: bytes) -> None:
    with pytest.raises(WrongRequest):
        text_request(text)


def test_other_bytes_are_refused_with_one_error() -> None:
    for data in (b"", b"\1\0", b"\x09", b"\2\0", struct.pack("<BBfBQI", 3, 0, 2.0, 1, 5, 0)):
        with pytest.raises(WrongRequest):
            binary_request(data)


@given(st.binary(max_size=64))
def test_no_bytes_raise_anything_else(data: bytes) -> None:
    for decode in (text_request, binary_request):
        with suppress(WrongRequest):
            decode(data)


async def test_a_lack_that_lasts_is_said_once_and_another_failure_as_ever(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    loop, failures = asyncio.get_running_loop(), loop_failures()
    for _ in range(3):
        error = OSError(errno.ENFILE, "Too many open files in system")
        failures(loop, {"message": "socket.accept()", "exception": error})
    assert capfd.readouterr().err.count("\n") == 1
    failures(loop, {"message": "a callback failed", "exception": ValueError("wrong")})
    assert "a callback failed" in caplog.text
