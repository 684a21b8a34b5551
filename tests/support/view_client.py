"""A small client of the Foxglove WebSocket protocol."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any, NamedTuple

from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

from robotctl.view.server import ViewServer
from robotctl.view.viewer import Admission
from tests.support.waiting import DEADLINE_S

SDK = "foxglove.sdk.v1"


class Received(NamedTuple):
    """One message of a topic."""

    subscription: int
    log_ns: int
    data: bytes


class ViewClient:
    """A connection to a view; it sorts received messages into lists."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.channels: dict[str, dict[str, Any]] = {}
        """Topic -> its offer."""
        self.said: list[dict[str, Any]] = []
        """All received messages in JSON."""
        self.messages: list[Received] = []
        self.responses: list[dict[str, Any]] = []

    async def until(self, condition: Callable[[], object]) -> None:
        """Receive until a condition holds."""
        async with asyncio.timeout(DEADLINE_S):
            while not condition():
                self._take(await self.socket.recv())

    async def receive_for(self, seconds: float) -> None:
        """Receive for `seconds`."""
        try:
            async with asyncio.timeout(seconds):
                while True:
                    self._take(await self.socket.recv())
        except TimeoutError:
            pass

    async def ask(self, **fields: Any) -> None:
        """Send a request in JSON."""
        await self.socket.send(json.dumps(fields))

    async def subscribe(self, *topics: str) -> None:
        """Subscribe to topics; the id of a subscription is 1000 above that of its channel."""
        await self.until(lambda: set(topics) <= self.channels.keys())
        ids = [self.channels[topic]["id"] for topic in topics]
        wanted = [{"id": 1000 + each, "channelId": each} for each in ids]
        await self.ask(op="subscribe", subscriptions=wanted)

    async def unsubscribe(self, topic: str) -> None:
        """End the subscription to a topic."""
        await self.ask(op="unsubscribe", subscriptionIds=[1000 + self.channels[topic]["id"]])

    async def call(self, service: str, call_id: int = 1) -> None:
        """Call a service without parameters."""
        offers = [each for said in self.said for each in said.get("services", ())]
        (offer,) = (each for each in offers if each["name"] == service)
        head = struct.pack("<BIII", 2, offer["id"], call_id, 4)
        await self.socket.send(head + b"json{}")

    async def offer_twist(self, topic: str = "/cmd_vel", encoding: str = "json") -> None:
        """Offer a channel with the id 5."""
        kind = "geometry_msgs/msg/Twist"
        channel = {"id": 5, "topic": topic, "encoding": encoding, "schemaName": kind}
        await self.ask(op="advertise", channels=[channel])

    async def publish_twist(self, linear_mps: float, angular_rps: float) -> None:
        """Publish on the channel with the id 5."""
        twist = {"linear": {"x": linear_mps}, "angular": {"z": angular_rps}}
        await self.socket.send(struct.pack("<BI", 1, 5) + json.dumps(twist).encode())

    def of(self, topic: str) -> list[Received]:
        """Return the messages of a topic."""
        subscription = 1000 + self.channels[topic]["id"]
        return [each for each in self.messages if each.subscription == subscription]

    def op(self, name: str) -> list[dict[str, Any]]:
        """Return the received JSON messages with the operation `name`."""
        return [each for each in self.said if each["op"] == name]

    def _take(self, received: str | bytes) -> None:
        if isinstance(received, str):
            said = json.loads(received)
            self.said.append(said)
            for channel in said["channels"] if said["op"] == "advertise" else ():
                self.channels[channel["topic"]] = channel
            return
        match received[0]:
            case 1:
                subscription, log_ns = struct.unpack_from("<IQ", received, 1)
                self.messages.append(Received(subscription, log_ns, received[13:]))
            case 3:
                self.responses.append(json.loads(received[17:]))


@asynccontextmanager
async def view_client(
    url: str,
    *,
    subprotocol: str = SDK,
    origin: str | None = None,
    headers: Mapping[str, str] | None = None,
) -> AsyncIterator[ViewClient]:
    """Connect for a block; yield the client.

    Raises:
        InvalidHandshake: The server refuses the connection.
    """
    async with connect(
        url,
        subprotocols=[Subprotocol(subprotocol)],
        origin=origin,  # type: ignore[arg-type]  # a NewType of str
        additional_headers=headers,
        max_size=None,
        compression=None,
        proxy=None,
    ) as socket:
        try:
            yield ViewClient(socket)
        finally:
            socket.transport.abort()  # a closing handshake would wait behind unread messages


TOKEN = "a-token-of-this-run"
STRING = ("std_msgs/msg/String", "string data\n")


class Served:
    """A running server, its port, and the URL with its token."""

    def __init__(self, server: ViewServer, port: int) -> None:
        self.server = server
        self.port = port
        self.url = f"ws://127.0.0.1:{port}/?token={TOKEN}"


@asynccontextmanager
async def served(**options: Any) -> AsyncIterator[Served]:
    """Serve during a block."""
    server = ViewServer("test", Admission(TOKEN), **options)
    port = await server.listen("127.0.0.1", 0)
    running = asyncio.create_task(server.run())
    try:
        yield Served(server, port)
    finally:
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
        server.close()
