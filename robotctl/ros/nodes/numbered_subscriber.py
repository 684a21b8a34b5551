"""Receives one value of each message, with what identifies it: its publisher and its number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from robotctl.ros.executor import RawTap
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session

T = TypeVar("T")


class NumberedSubscriber(Generic[T]):
    """Receives from publishers of any QoS, as a part of the hidden node.

    `read` returns the value in a serialized message, and raises nothing. `publisher` is the gid in
    hexadecimal digits, `sequence` its own number of the message.
    """

    def __init__(
        self,
        session: Session,
        message_class: Any,
        topic: str,
        read: Callable[[bytes], T],
        on_value: Callable[[T, str, int], None],
    ) -> None:
        """Call `on_value(value, publisher, sequence)` for each message."""
        self._read = read
        self._on_value = on_value
        tap: Any = RawTap(self._receive, latency_s=0.0)
        self._subscription = session.helper().create_subscription(
            message_class,
            topic,
            tap,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        self._on_value(self._read(data), gid.hex(), sequence)
