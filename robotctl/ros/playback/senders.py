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
"""How long a subscriber that acknowledges nothing may hold up a replay at full speed."""

ACKNOWLEDGED_POLL_S: Final = 0.001
"""The time between two checks for acknowledgements, which come after about 5 ms."""

MAX_OPEN_REQUESTS: Final = 10_000
"""Limit on the requests that are remembered until their second event comes."""

_CLOCK = struct.Struct("<4siI")
"""rosgraph_msgs/Clock: encapsulation, seconds, nanoseconds."""


def sender(publisher: Publisher) -> Callable[[bytes], bool]:
    """Return a function that publishes a message, and returns whether the middleware accepts it."""
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
    queue is no alternative: if a message is lost while the publisher keeps more messages than the
    subscriber's depth, Fast DDS 2.14 delivers nothing any more. The subscriber holds newer messages
    back until it has the lost one, but they fill its queue, so it refuses the lost one each time
    (`DataReaderHistory::received_change_keep_last`).
    """

    def __init__(self, publisher: Publisher, in_flight: int, stopped: threading.Event) -> None:
        """Publish with `publisher`; wait after `in_flight` messages, or its depth if that is less.

        Setting `stopped` ends a wait.
        """
        self.topic = str(publisher.topic_name)
        self.given_up = 0
        """How often a subscriber did not acknowledge within BLOCKED_S."""

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
        # Polled, because rclpy would hold the GIL while it waits.
        while not self._publisher.wait_for_all_acked(Duration()):
            if self._stopped.wait(ACKNOWLEDGED_POLL_S) or time.monotonic() > until_s:
                return False
        return True


def clock_sender(publisher: Publisher) -> Callable[[int], bool]:
    """Return a function that publishes a time [ns]; it returns whether that succeeded."""
    send_once = sender(publisher)

    def send(time_ns: int) -> bool:
        return send_once(_CLOCK.pack(ENCAPSULATION, *divmod(time_ns, NS_PER_S)))

    return send


class RequestSender:
    """Sends the request of an introspection event; called with the serialized event.

    Client and server may both have recorded an event of the same request, under different
    identities: the request is sent for the first event only. Responses are not waited for.
    """

    def __init__(self, client: Client, event_type: Any) -> None:
        self._client = client
        self._event_type = event_type
        self._balances: OrderedDict[tuple[int, str], int] = OrderedDict()
        """Request -> number of client events minus number of server events."""

    def __call__(self, data: bytes) -> bool | None:
        """Send the request; return whether that worked, or None if there was none to send."""
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
