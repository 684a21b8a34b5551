"""One connection of a viewer: admission, handshake, requests, and a bounded send queue."""

from __future__ import annotations

import asyncio
import hmac
import http
import ipaddress
import logging
import secrets
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Final, Protocol, cast
from urllib.parse import parse_qs, urlsplit

from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.typing import Subprotocol

from robotctl.view.foxglove import (
    SUBPROTOCOLS,
    ViewRequest,
    WrongRequest,
    binary_request,
    text_request,
    warning,
)

KNOWN_ORIGINS: Final = (
    "https://app.foxglove.dev",
    "https://studio.foxglove.dev",
    "file://",
    "http://localhost:8080",
    "http://127.0.0.1:8080",
)
"""The pages of Foxglove, the desktop applications, and Lichtblick in its container image."""

_TOKEN_BYTES: Final = 24


def new_token() -> str:
    """Return a token that cannot be guessed."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


# Any web page can open a WebSocket to this machine, also under a foreign host name (DNS rebinding).
# The token keeps out other users of the machine, too.


class Admission:
    """Checks the first request of a connection."""

    def __init__(self, token: str, origins: Iterable[str] = (), host: str = "localhost") -> None:
        """Allow KNOWN_ORIGINS and `origins`, and the host names of this computer and `host`."""
        self._token = token.encode()
        self._own_names = {"localhost", socket.gethostname().lower(), host.lower()}
        self._origins = {*KNOWN_ORIGINS, *origins}

    def refusal(self, target: str, hosts: Sequence[str], origins: Sequence[str]) -> str:
        """Return the reason to refuse a request, or ""; `target` is the path with the query."""
        if len(hosts) != 1 or not self._is_own_host(hosts[0]):
            return "the Host header names no address of this computer"
        if len(origins) > 1 or not self._origins.issuperset(origins):
            return "pages of this origin may not connect (robotctl view --origin allows one)"
        given = parse_qs(target.partition("?")[2]).get("token", [])
        if len(given) != 1 or not hmac.compare_digest(given[0].encode(), self._token):
            return "the URL does not have the token of this run: copy it from robotctl view"
        return ""

    def _is_own_host(self, header: str) -> bool:
        """Return whether a Host header names this computer, or is an IP address."""
        try:
            host = urlsplit(f"//{header}").hostname
        except ValueError:
            return False
        if not host:
            return False
        try:
            ipaddress.ip_address(host)
        except ValueError:
            return host in self._own_names
        return True


LARGE_BYTES: Final = 1 << 16
"""Size above which messages have a separate queue, so that they never displace small ones."""

MAX_MESSAGES: Final = 1024
"""Limit on the messages in each of the two queues."""

MAX_BYTES: Final = 256 << 10
"""Limit on the bytes in each of the two queues. A larger message may wait alone."""

MAX_CONTROL_BYTES: Final = 16 << 20
"""Limit on the bytes of waiting offers, notes and answers. A larger offer may wait alone."""

PIECE_BYTES: Final = 1 << 16
"""Bytes that the transport gets at once, as it copies those that the socket does not accept."""

TEXT: Final = 0x81
BINARY: Final = 0x82
"""The first byte of a WebSocket frame that is a whole message (RFC 6455, 5.2)."""


def frame_head(kind: int, length: int) -> bytes:
    """Return the head of an unmasked WebSocket frame for `length` bytes (RFC 6455, 5.2)."""
    if length < 126:
        return bytes((kind, length))
    if length < 1 << 16:
        return struct.pack("!BBH", kind, 126, length)
    return struct.pack("!BBQ", kind, 127, length)


class OverfullOutbox(Exception):
    """The offers, notes and answers that wait to be sent would exceed MAX_CONTROL_BYTES."""


class Outbox:
    """A send queue: first offers, notes and answers, then small messages, then large ones."""

    def __init__(self) -> None:
        self._control: deque[bytes] = deque()
        self._control_bytes = 0
        self._messages = _Lane()
        self._large = _Lane()
        self._begun: memoryview = memoryview(b"")
        """The rest of a frame that is partly sent."""

    def __bool__(self) -> bool:
        """Return whether anything waits."""
        return bool(self._begun or self._control or self._messages or self._large)

    @property
    def dropped(self) -> int:
        """The number of topic messages that were removed before they were sent."""
        return self._messages.dropped + self._large.dropped

    @property
    def waits_for_control(self) -> bool:
        """Whether offers, notes or answers wait to be sent."""
        return bool(self._control)

    def put_control(self, frame: bytes) -> None:
        """Add a frame that is never dropped.

        Raises:
            OverfullOutbox: The control frames would exceed MAX_CONTROL_BYTES.
        """
        if self._control and self._control_bytes + len(frame) > MAX_CONTROL_BYTES:
            raise OverfullOutbox
        self._control.append(frame)
        self._control_bytes += len(frame)

    def put_message(self, head: bytes, data: bytes) -> None:
        """Add a message of a topic, and drop the oldest ones above MAX_MESSAGES or MAX_BYTES."""
        (self._large if len(data) > LARGE_BYTES else self._messages).put(head, data)

    def take(self) -> bytes:
        """Remove and return the next bytes to send, b"" if none wait."""
        if not self._begun and self._control:
            frame = self._control.popleft()
            self._control_bytes -= len(frame)
            self._begun = memoryview(frame)
        if self._begun:
            piece, self._begun = self._begun[:PIECE_BYTES], self._begun[PIECE_BYTES:]
            return bytes(piece)
        if self._messages:
            return self._messages.take_together()
        if self._large:
            head, data = self._large.take()
            self._begun = memoryview(data)
            return head
        return b""


class _Lane:
    """A bounded queue of messages that drops the oldest ones."""

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: deque[tuple[bytes, bytes]] = deque()
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put(self, head: bytes, data: bytes) -> None:
        waiting = self._waiting
        waiting.append((head, data))
        self._bytes += len(data)
        while len(waiting) > MAX_MESSAGES or (self._bytes > MAX_BYTES and len(waiting) > 1):
            self.take()
            self.dropped += 1

    def take(self) -> tuple[bytes, bytes]:
        head, data = self._waiting.popleft()
        self._bytes -= len(data)
        return head, data

    def take_together(self) -> bytes:
        """Return the next messages, joined, until they have PIECE_BYTES."""
        pieces: list[bytes] = []
        size = 0
        while self._waiting and size < PIECE_BYTES:
            pieces += self.take()
            size += len(pieces[-2]) + len(pieces[-1])
        return b"".join(pieces)


MAX_REQUEST_BYTES: Final = 1 << 20
"""Limit on a message of a client."""

SOCKET_BYTES: Final = 128 << 10
"""The socket's send buffer for a viewer."""

TRY_LATER: Final = 1013
"""The close code for a viewer beyond MAX_VIEWERS (IANA's registry for RFC 6455)."""

_LOGGER: Final = logging.getLogger("robotctl.view.websocket")
_LOGGER.disabled = True  # or any client could fill the terminal with warnings


class ViewerHost(Protocol):
    """The methods of the server that the connections of viewers call."""

    def connected(self, viewer: Viewer) -> None:
        """Accept a connection before its handshake."""

    def admit(self, viewer: Viewer) -> None:
        """Add a viewer whose handshake is done."""

    def request(self, viewer: Viewer, request: ViewRequest) -> None:
        """Carry out a request of a viewer, or raise WrongRequest if that is impossible."""

    def leave(self, viewer: Viewer) -> None:
        """Forget a connection that has ended, admitted or not."""


class Viewer(asyncio.Protocol):
    """The connection of one viewer. It passes requests to the server and sends queued frames."""

    def __init__(self, host: ViewerHost, admission: Admission) -> None:
        self.outbox = Outbox()
        self.subscriptions: dict[int, int] = {}
        """Subscription id -> channel id."""

        self.offers: set[int] = set()
        """The viewer's ids of the channels on which it publishes."""

        self.told_dropped = 0
        """The number of dropped messages that was last sent to the viewer."""

        self.since_s = time.monotonic()
        """When the viewer connected, or its socket last became full [s, time.monotonic]."""

        self.admitted = False
        self._host = host
        self._admission = admission
        self._transport: asyncio.Transport | None = None
        self._websocket = ServerProtocol(
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
            max_size=MAX_REQUEST_BYTES,
            logger=_LOGGER,
        )
        self._kind = Opcode.TEXT
        self._message = bytearray()
        """The received fragments of a message."""

        self.is_stalled = False
        """Whether the socket is full, and accepts no data now."""

        self._ends = False
        """Whether to close the connection after the queue is sent."""

    # From the loop

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Limit the send buffers of transport and kernel, and register with the server."""
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=0)
        sock = self._transport.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BYTES)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._host.connected(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the viewer from the server."""
        self._transport = None
        self._host.leave(self)

    def pause_writing(self) -> None:
        """Send nothing until the socket accepts more."""
        self.is_stalled = True
        self.since_s = time.monotonic()

    def resume_writing(self) -> None:
        """Continue to send, in the next loop iteration: the socket accepts data again."""
        self.is_stalled = False
        # Not at once: a transport that is closed within this call would be ended twice.
        asyncio.get_running_loop().call_soon(self.flush)

    def data_received(self, data: bytes) -> None:
        """Parse received bytes of the handshake or of requests, and carry these out."""
        self._websocket.receive_data(data)
        self._take_events()

    def eof_received(self) -> None:
        """Handle the end of the bytes from the viewer."""
        self._websocket.receive_eof()
        self._take_events()

    # From the server

    def tell(self, message: str | bytes) -> None:
        """Send a channel offer, a note or an answer. Disconnect if too many bytes wait."""
        kind, data = (TEXT, message.encode()) if isinstance(message, str) else (BINARY, message)
        try:
            self.outbox.put_control(frame_head(kind, len(data)) + data)
        except OverfullOutbox:
            self.abort()
            return
        self.flush()

    def flush(self) -> None:
        """Send queued frames until the socket is full."""
        transport = self._transport
        if transport is None:
            return
        while not (self.is_stalled or transport.is_closing()) and (piece := self.outbox.take()):
            transport.write(piece)
        if self._ends and not self.outbox:
            transport.close()

    def close(self, code: int, reason: str) -> None:
        """End the connection with a close frame."""
        if self._websocket.state is State.OPEN:
            self._websocket.send_close(code, reason)
            self._send_protocol_bytes()

    def abort(self) -> None:
        """End the connection at once, without the queued frames."""
        if self._transport is not None:
            self._transport.abort()

    # The handshake and the frames

    def _take_events(self) -> None:
        for event in self._websocket.events_received():
            if isinstance(event, Request):
                self._shake_hands(event)
            elif isinstance(event, Frame):
                self._take_frame(event)
        self._send_protocol_bytes()

    def _shake_hands(self, request: Request) -> None:
        headers, websocket = request.headers, self._websocket
        if websocket.eof_sent:  # the bytes after the request are no frame
            return
        try:
            refusal = self._admission.refusal(
                request.path, headers.get_all("Host"), headers.get_all("Origin")
            )
            response = (
                websocket.reject(http.HTTPStatus.FORBIDDEN, f"{refusal}\n")
                if refusal
                else websocket.accept(request)
            )
        except UnicodeEncodeError:  # some versions of websockets keep bytes that are no ASCII
            text = "the request is not in ASCII\n"
            response = self._websocket.reject(http.HTTPStatus.BAD_REQUEST, text)
        self._websocket.send_response(response)
        self._send_protocol_bytes()
        if self._websocket.state is State.OPEN:
            self.admitted = True
            self._host.admit(self)

    def _take_frame(self, frame: Frame) -> None:
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY):
            self._kind = frame.opcode
        elif frame.opcode is not Opcode.CONT:
            return
        self._message += frame.data
        if not frame.fin:
            return
        whole = bytes(self._message)
        self._message.clear()
        decode: Callable[[bytes], ViewRequest] = (
            text_request if self._kind is Opcode.TEXT else binary_request
        )
        try:
            self._host.request(self, decode(whole))
        except WrongRequest as error:
            self.tell(warning(str(error)))

    def _send_protocol_bytes(self) -> None:
        """Send the bytes that the handshake, a ping or a close frame requires."""
        for data in self._websocket.data_to_send():
            if self._transport is None:
                return
            if not data:  # the protocol wants the stream to end
                self._ends = True
            elif not self.admitted:
                self._transport.write(data)
            else:  # queued: a frame may be partly sent
                try:
                    self.outbox.put_control(data)
                except OverfullOutbox:
                    self.abort()
        self.flush()
