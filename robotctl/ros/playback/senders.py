"""Functions that send the messages of a replay: to a topic, to a service, or as /clock."""

from __future__ import annotations

import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Final

from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message

from robotctl.kernel.units import NS_PER_S
from robotctl.messages.cdr import ENCAPSULATION

BLOCKED_S: Final = 5.0
"""How long a replay at full speed waits for a subscriber that does not acknowledge."""

ACKNOWLEDGED_POLL_S: Final = 0.001
"""How often [s] to check for acknowledgements, which come after about 5 ms."""

MAX_OPEN_REQUESTS: Final = 10_000
"""Limit on the sent requests that are remembered, because a second event of each may come."""

_CLOCK = struct.Struct("<4siI")
"""rosgraph_msgs/Clock: encapsulation, seconds, nanoseconds."""


def sender(publisher: Publisher) -> Callable[[bytes], bool]:
    """Return a function that publishes a message and returns whether the middleware accepted it."""
    publish = publisher.publish

    def send(data: bytes) -> bool:
        try:
            publish(data)
        except _rclpy.RCLError:
            return False
        return True

    return send


class PatientSender:
    """Publishes messages no faster than reliable subscribers acknowledge them.

    After `in_flight` messages it waits until all are acknowledged, at most BLOCKED_S. A KEEP_ALL
    queue would do the same, but with Fast DDS 2.14 one lost message could then block a subscriber
    forever: while the lost message is missing, newer messages fill the subscriber's queue, and so
    it refuses the lost message each time (`DataReaderHistory::received_change_keep_last`).
    """

    def __init__(self, publisher: Publisher, in_flight: int, stopped: threading.Event) -> None:
        """Publish with `publisher`, and wait after `in_flight` messages, or its queue's depth if
        that is less; setting `stopped` ends a wait."""
        self.topic = str(publisher.topic_name)
        self.given_up = 0
        """How many waits ended before all messages were acknowledged."""

        self._send = sender(publisher)
        self._publisher = publisher
        self._stopped = stopped
        self._in_flight = min(in_flight, int(publisher.qos_profile.depth))
        self._unacknowledged = 0

    def __call__(self, data: bytes) -> bool:
        """Publish a message; return whether the middleware accepted it."""
        if self._unacknowledged >= self._in_flight:
            self.given_up += not self._is_acknowledged()
            self._unacknowledged = 0
        self._unacknowledged += 1
        return self._send(data)

    def _is_acknowledged(self) -> bool:
        until_s = time.monotonic() + BLOCKED_S
        # Polled, because a wait in rclpy would hold the GIL.
        while not self._publisher.wait_for_all_acked(Duration()):
            if self._stopped.wait(ACKNOWLEDGED_POLL_S) or time.monotonic() > until_s:
                return False
        return True


def clock_sender(publisher: Publisher) -> Callable[[int], bool]:
    """Return a function that publishes a time [ns] and returns whether this succeeded."""
    send_once = sender(publisher)

    def send(time_ns: int) -> bool:
        return send_once(_CLOCK.pack(ENCAPSULATION, *divmod(time_ns, NS_PER_S)))

    return send


class RequestSender:
    """Sends the request in a serialized introspection event; does not wait for the response.

    A recording may have two events of one request, one by the client and one by the server, with
    different client gids. The request is sent only for the first of these two events.
    """

    def __init__(self, client: Client, event_type: Any) -> None:
        self._client = client
        self._event_type = event_type
        self._balances: OrderedDict[tuple[int, str], int] = OrderedDict()
        """Request -> its number of events from clients minus its number of events from servers."""

    def __call__(self, data: bytes) -> bool | None:
        """Send the event's request; return whether that worked, or None if it is not to be sent."""
        try:
            event = deserialize_message(data, self._event_type)
        except _rclpy.RCLError:
            return False
        if not event.request or self._was_sent(event):
            return None
        if not self._client.service_is_ready():
            return False
        with self._client.handle:
            self._client.handle.send_request(event.request[0])
        return True

    def _was_sent(self, event: Any) -> bool:
        info = event.info
        key = (info.sequence_number, repr(event.request[0]))  # bytes differ in their padding
        balance = self._balances.pop(key, 0)
        change = 1 if info.event_type == info.REQUEST_SENT else -1
        if balance + change:
            self._balances[key] = balance + change
        if len(self._balances) > MAX_OPEN_REQUESTS:
            self._balances.popitem(last=False)
        return balance * change < 0
