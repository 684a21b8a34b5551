"""The WebSocket server of a view, with its socket, its viewers and its channels."""

from __future__ import annotations

import asyncio
import errno
import os
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from robotctl.base.errors import Refused
from robotctl.view.foxglove import (
    ClientMessage,
    ClientOffers,
    ClientWithdrawal,
    Offer,
    ServiceCall,
    Subscribe,
    Unsubscribe,
    ViewChannel,
    ViewRequest,
    ViewService,
    WrongRequest,
    advertise,
    advertise_services,
    message_head,
    remove_status,
    server_info,
    unadvertise,
    warning,
)
from robotctl.view.viewer import BINARY, TRY_LATER, Admission, Viewer, frame_head

DEFAULT_PORT: Final = 8765
"""The default port of Foxglove."""


def listening_socket(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens on `port` or, if that is None, on DEFAULT_PORT or a free port.

    Raises:
        Refused: The host has no address, or the socket cannot listen on it.
    """
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise _no_host(host, error.strerror or str(error)) from error
    except UnicodeError as error:  # a label of the name is empty or too long
        raise _no_host(host, "it cannot be a name") from error
    family, *_, (name, _, *rest) = found[0]
    both = family is socket.AF_INET6 and socket.has_dualstack_ipv6()
    try:
        try:
            address = (name, DEFAULT_PORT if port is None else port, *rest)
            return socket.create_server(address, family=family, dualstack_ipv6=both)
        except OSError:
            if port is not None:
                raise
            return socket.create_server((name, 0, *rest), family=family, dualstack_ipv6=both)
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise _no_host(host, os.strerror(error.errno)) from error
        where = f"{host} port {DEFAULT_PORT if port is None else port}"
        raise Refused(
            f"the view cannot listen on {where} ({os.strerror(error.errno or 0)})",
            "choose another --port, or leave it out for a free one",
        ) from error


def _no_host(host: str, reason: str) -> Refused:
    return Refused(
        f"the view cannot listen on {host!r} ({reason})",
        "give an address of this computer as --host, or leave it out for 127.0.0.1",
    )


MAX_SUBSCRIPTIONS: Final = 10_000
"""Limit on the subscriptions of one viewer."""


MAX_VIEWERS: Final = 128
"""Limit on viewers, above which further ones are refused with the code TRY_LATER."""

MAX_CONNECTIONS: Final = 2 * MAX_VIEWERS
"""Limit on connections, above which further ones are closed at once."""

MAX_OFFERS: Final = 1_000
"""Limit on the channels that a viewer offers."""

HANDSHAKE_S: Final = 5.0
"""How long a handshake may take [s]."""

STALL_S: Final = 30.0
"""A viewer whose socket accepts no data for this time [s] is disconnected."""

PERIOD_S: Final = 1.0
"""The period [s] of the checks for stalled viewers, late handshakes and dropped messages."""

_MESSAGE_HEAD_BYTES: Final = len(message_head(0, 0))


class ViewServer:
    """Offers channels, and sends their messages to subscribed viewers, in the loop's thread."""

    def __init__(
        self,
        name: str,
        admission: Admission,
        *,
        capabilities: Sequence[str] = (),
        services: Sequence[ViewService] = (),
    ) -> None:
        self._admission = admission
        self._services = services
        self._greeting = server_info(name, secrets.token_hex(8), capabilities)
        self._channels: dict[int, ViewChannel] = {}
        self._last_id = 0
        """Ids of channels are never reused."""

        self._subscribers: dict[int, dict[Viewer, int]] = {}
        """Channel id -> viewer -> the viewer's subscription id."""

        self._notes: dict[str, str] = {}
        self._connections: set[Viewer] = set()
        self._viewers: set[Viewer] = set()
        self._unflushed: set[Viewer] = set()
        self._listener: asyncio.Server | None = None
        self.on_subscribed: Callable[[int], None] = lambda channel_id: None
        """Called when a viewer has subscribed to a channel."""

        self.on_unwatched: Callable[[int], None] = lambda channel_id: None
        """Called when the last subscription to a channel has ended."""

        self.on_call: Callable[[Viewer, ServiceCall], None] | None = None
        self.on_offer: Callable[[Offer], None] | None = None
        """Called with a channel that a viewer offers; raises WrongRequest to refuse the channel."""

        self.on_message: Callable[[Viewer, ClientMessage], None] | None = None
        """Called with a message of a viewer on a channel that it offers."""

    # The life of the server

    async def listen(self, host: str, port: int | None) -> int:
        """Listen on `port`, or if that is None on DEFAULT_PORT or a free port. Return the port.

        Raises:
            Refused: The server cannot listen on the address.
        """
        sock = listening_socket(host, port)
        loop = asyncio.get_running_loop()
        connection = partial(Viewer, self, self._admission)
        self._listener = await loop.create_server(connection, sock=sock)
        return int(sock.getsockname()[1])

    async def run(self) -> None:
        """End stalled connections and slow handshakes until cancelled; report dropped messages."""
        while True:
            await asyncio.sleep(PERIOD_S)
            now_s = time.monotonic()
            for viewer in list(self._connections):
                is_viewer = viewer in self._viewers
                limit_s = STALL_S if is_viewer else HANDSHAKE_S
                if (viewer.is_stalled or not is_viewer) and now_s - viewer.since_s > limit_s:
                    viewer.abort()
                else:
                    _tell_dropped(viewer)

    def close(self) -> None:
        """Stop listening, and end every connection."""
        if self._listener is not None:
            self._listener.close()
        for viewer in list(self._connections):
            viewer.close(1001, "the view has ended")
            if viewer.is_stalled or not viewer.admitted:
                viewer.abort()

    # The channels

    def offer(self, topic: str, type_name: str, definition: str) -> int:
        """Offer a topic to all viewers, and return the id of its channel."""
        self._last_id += 1
        channel = ViewChannel(self._last_id, topic, type_name, definition)
        self._channels[channel.id] = channel
        self._tell_all(advertise([channel]))
        return channel.id

    def withdraw(self, channel_id: int) -> None:
        """Withdraw a channel from all viewers, and end its subscriptions."""
        del self._channels[channel_id]
        for viewer, subscription in self._subscribers.pop(channel_id, {}).items():
            del viewer.subscriptions[subscription]
        self._tell_all(unadvertise([channel_id]))

    def publish(self, channel_id: int, log_ns: int, data: bytes | memoryview) -> None:
        """Queue a message for the viewers of a channel, to be sent in the loop's next iteration."""
        subscribers = self._subscribers.get(channel_id)
        if not subscribers:
            return
        kept = bytes(data)
        frame = frame_head(BINARY, _MESSAGE_HEAD_BYTES + len(kept))
        if not self._unflushed:
            asyncio.get_running_loop().call_soon(self._flush)
        for viewer, subscription in subscribers.items():
            viewer.outbox.put_message(frame + message_head(subscription, log_ns), kept)
        self._unflushed.update(subscribers)

    def note(self, id: str, message: str) -> None:  # noqa: A002 - the field's name
        """Show `message` to all present and later viewers; a `message` of "" removes the note."""
        if message and self._notes.get(id) != message:
            self._notes[id] = message
            self._tell_all(warning(message, id))
        elif not message and self._notes.pop(id, None) is not None:
            self._tell_all(remove_status([id]))

    # From the connections

    def connected(self, viewer: Viewer) -> None:
        """Register a connection before its handshake; end any connection above MAX_CONNECTIONS."""
        self._connections.add(viewer)
        if len(self._connections) > MAX_CONNECTIONS:
            viewer.abort()

    def admit(self, viewer: Viewer) -> None:
        """Send greeting, offers and notes to a new viewer, or refuse it above MAX_VIEWERS."""
        if len(self._viewers) >= MAX_VIEWERS:
            viewer.close(TRY_LATER, f"{MAX_VIEWERS} viewers are connected already")
            return
        self._viewers.add(viewer)
        viewer.tell(self._greeting)
        if self._channels:
            viewer.tell(advertise(self._channels.values()))
        if self._services:
            viewer.tell(advertise_services(self._services))
        for id_, message in self._notes.items():
            viewer.tell(warning(message, id_))

    def leave(self, viewer: Viewer) -> None:
        """Forget a connection and its subscriptions."""
        self._connections.discard(viewer)
        self._unflushed.discard(viewer)
        for subscription in list(viewer.subscriptions):
            self._unsubscribe(viewer, subscription)
        self._viewers.discard(viewer)

    def request(self, viewer: Viewer, request: ViewRequest) -> None:
        """Carry out a request of a viewer, or raise WrongRequest if that is impossible."""
        if viewer not in self._viewers:
            return  # its connection is being closed
        match request:
            case Subscribe():
                for subscription, channel_id in request.channels.items():
                    self._subscribe(viewer, subscription, channel_id)
            case Unsubscribe():
                for subscription in request.subscriptions:
                    self._unsubscribe(viewer, subscription)
            case ServiceCall() if self.on_call is not None:
                self.on_call(viewer, request)
            case ClientOffers() if self.on_offer is not None:
                for offer in request.offers:
                    self.on_offer(offer)
                    if len(viewer.offers) >= MAX_OFFERS:
                        raise WrongRequest(f"a viewer may offer {MAX_OFFERS} channels")
                    viewer.offers.add(offer.id)
            case ClientWithdrawal():
                viewer.offers.difference_update(request.ids)
            case ClientMessage() if self.on_message is not None and request.id in viewer.offers:
                self.on_message(viewer, request)
            case _:
                raise WrongRequest("this view is read-only, or does not take that")

    def _subscribe(self, viewer: Viewer, subscription: int, channel_id: int) -> None:
        """Begin a subscription to an offered channel, or raise WrongRequest."""
        if channel_id not in self._channels:
            return
        watching = self._subscribers.get(channel_id, {})
        taken = subscription in viewer.subscriptions or viewer in watching
        if taken or len(viewer.subscriptions) >= MAX_SUBSCRIPTIONS:
            raise WrongRequest(f"subscription {subscription}: one a channel, each with its own id")
        viewer.subscriptions[subscription] = channel_id
        self._subscribers[channel_id] = watching | {viewer: subscription}
        self.on_subscribed(channel_id)

    def _unsubscribe(self, viewer: Viewer, subscription: int) -> None:
        channel_id = viewer.subscriptions.pop(subscription, None)
        if channel_id is None:
            return
        del self._subscribers[channel_id][viewer]
        if not self._subscribers[channel_id]:
            del self._subscribers[channel_id]
            self.on_unwatched(channel_id)

    def _flush(self) -> None:
        unflushed, self._unflushed = self._unflushed, set()
        for viewer in unflushed:
            viewer.flush()

    def _tell_all(self, message: str) -> None:
        for viewer in list(self._viewers):
            viewer.tell(message)


def _tell_dropped(viewer: Viewer) -> None:
    """Send a viewer its count of dropped messages if that changed, unless offers or notes wait."""
    dropped = viewer.outbox.dropped
    if dropped != viewer.told_dropped and not viewer.outbox.waits_for_control:
        viewer.told_dropped = dropped
        text = f"{dropped} messages were dropped: this connection takes less than is published"
        viewer.tell(warning(text, "dropped"))
