"""RawTap: the callback of a subscription that takes serialized messages fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

SerializedData = bytes | memoryview
"""A serialized message. Messages of more than 1 MiB are a memoryview of the executor's buffer,
valid during the call only, so that a message that is not kept is not copied."""

Sink = Callable[[bytes, int, int, int, bytes], object]
"""Called with (data, received_ns, source_ns, sequence, gid) for each message."""

ViewSink = Callable[[SerializedData, int, int, int, bytes], object]
"""A sink that accepts views of large messages, and copies what it keeps of them."""

UNKNOWN_GID = b""
"""The gid of messages whose publisher is not known."""


def _nothing() -> None:
    """Do nothing: no AsyncioExecutor serves the subscription."""


class RawTap:
    """The callback of a raw subscription, with the publisher's gid of each message.

        node.create_subscription(msg_type, topic, RawTap(sink), qos, raw=True)

    `sink` is called with the serialized message, the wall-clock times in ns at which it was
    received and published, the publisher's sequence number, and the publisher's gid (16 bytes).
    A gap in the sequence of one gid is a lost message. The sink is synchronous: a task for each
    message would be too slow for 45,000 messages a second.

    An AsyncioExecutor takes such messages past rclpy, and lets them collect for `latency_s`,
    because one wake-up costs ten times as much as taking one message. The time stamps stay exact:
    the middleware takes them. Where the subscription's queue is too short for that (below 500 for
    the default) messages collect for less time or not at all. Any other executor calls the tap as
    an ordinary callback; the gid is then `UNKNOWN_GID`.
    """

    __slots__ = ("__weakref__", "latency_s", "poll", "sink", "views")

    def __init__(self, sink: Sink, *, latency_s: float | None = 0.01, views: bool = False) -> None:
        """Call `sink` at most about `latency_s` seconds late; 0 means at once for each message.

        With None it is called when `poll` is, and messages do not wake the loop.
        `views` says that `sink` is a ViewSink.
        """
        self.sink = sink
        self.latency_s = latency_s
        self.views = views
        self.poll: Callable[[], None] = _nothing
        """Takes the messages that have arrived, without waiting for more to collect; set by the
        AsyncioExecutor that serves the subscription."""

    def __call__(self, data: bytes, info: Mapping[str, Any]) -> None:
        """Take a message from an executor of rclpy."""
        self.sink(
            data,
            info["received_timestamp"],
            info["source_timestamp"],
            info["publication_sequence_number"] or 0,
            UNKNOWN_GID,
        )
