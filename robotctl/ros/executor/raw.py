"""The hot path: a subscription that hands over bytes, with all that the middleware knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Sink = Callable[[bytes, int, int, int, bytes], object]
"""Called with (data, received_ns, source_ns, sequence, gid) for each message."""

Data = bytes | memoryview
"""A serialized message. What is larger than `rcl.LARGE_BYTES` is a memoryview that is valid during
the call only, so that a message that is not kept is not copied."""

ViewSink = Callable[[Data, int, int, int, bytes], object]
"""A sink that copies what it keeps."""

UNKNOWN_GID = b""


def _nothing() -> None:
    """Do nothing: no executor serves the subscription."""


class RawTap:
    """The callback of a raw subscription that wants the publisher's gid, and wants it fast.

        node.create_subscription(msg_type, topic, RawTap(sink), qos, raw=True)

    `sink` is called with the serialized message, the wall-clock times in ns at which it was
    received and published, the publisher's sequence number, and the publisher's gid (16 bytes).
    A gap in the sequence of one gid is a lost message. The sink is synchronous: at 45,000
    messages a second there is no time for a task each.

    An AsyncioExecutor takes such messages past rclpy, and lets them collect for `latency_s`,
    because waking up for each would cost ten times as much as taking it. The time stamps do not
    suffer: the middleware takes them. Where the subscription's queue is too short for that (below
    500 for the default) they collect for less or not at all. Any other executor calls the tap as
    an ordinary callback; the gid is then `UNKNOWN_GID`.
    """

    __slots__ = ("__weakref__", "latency_s", "look", "sink", "views")

    def __init__(self, sink: Sink, *, latency_s: float = 0.01, views: bool = False) -> None:
        """Call `sink` at most about `latency_s` seconds late; with 0 at every single message.

        `views` says that it is a ViewSink.
        """
        self.sink = sink
        self.latency_s = latency_s
        self.views = views
        self.look: Callable[[], None] = _nothing
        """Takes what has come by now, without waiting for more to collect; an AsyncioExecutor
        sets it."""

    def __call__(self, data: bytes, info: Mapping[str, Any]) -> None:
        """Take a message from an executor of rclpy."""
        self.sink(
            data,
            info["received_timestamp"],
            info["source_timestamp"],
            info["publication_sequence_number"] or 0,
            UNKNOWN_GID,
        )
