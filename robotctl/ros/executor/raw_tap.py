"""RawTap: a subscription callback that receives serialized messages fast."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from robotctl.ros.executor import rcutils
from robotctl.ros.executor.rcutils import RclCallFailed

SerializedData = bytes | memoryview
"""A serialized message. Above 1 MiB it is a memoryview of the executor's buffer, which is valid
only during the call of the sink: the sink must copy what it keeps."""

Sink = Callable[[bytes, int, int, int, bytes], object]
"""Called with (data, received_ns, source_ns, sequence, gid) for each message."""

ViewSink = Callable[[SerializedData, int, int, int, bytes], object]
"""A sink that accepts views of large messages, and copies what it keeps of them."""

UNKNOWN_GID = b""
"""The gid of messages whose publisher is not known."""


class RawTap:
    """A callback for a raw subscription that also gets the publisher's gid of each message.

        node.create_subscription(msg_type, topic, RawTap(sink), qos, raw=True)

    `sink` is called with the serialized message, the wall-clock times in ns at which it was
    received and published, the publisher's sequence number, and the publisher's gid (16 bytes).
    A gap in the numbers of one gid is a lost message. The sink is synchronous: a task for each
    message would be too slow for 45,000 messages a second.

    An AsyncioExecutor reads such messages without rclpy, and collects them for `latency_s`,
    because one wake-up costs ten times as much as reading one message. The time stamps stay exact:
    the middleware sets them. If the subscription's queue is short (below 500 messages, for the
    default `latency_s`), messages are collected for less time or not at all. An executor of rclpy
    calls the tap as an ordinary callback; the gid is then `UNKNOWN_GID`.
    """

    __slots__ = ("__weakref__", "latency_s", "poll", "sink", "views")

    def __init__(self, sink: Sink, *, latency_s: float | None = 0.01, views: bool = False) -> None:
        """Call `sink` at most about `latency_s` seconds late; 0 means at once for each message.

        If `latency_s` is None, messages do not wake the loop: only `poll` calls the sink.
        `views` says that `sink` is a ViewSink.
        """
        self.sink = sink
        self.latency_s = latency_s
        self.views = views
        self.poll: Callable[[], None] = lambda: None
        """Passes the messages that have arrived to `sink`, without waiting for more; set by the
        AsyncioExecutor that serves the subscription."""

    def __call__(self, data: bytes, info: Mapping[str, Any]) -> None:
        """Pass a message to `sink`; an executor of rclpy calls this."""
        self.sink(
            data,
            info["received_timestamp"],
            info["source_timestamp"],
            info["publication_sequence_number"] or 0,
            UNKNOWN_GID,
        )


_RET_OK = 0
_RET_SUBSCRIPTION_TAKE_FAILED = 401


@cache
def _take_serialized() -> Any:
    # PyDLL keeps the GIL: to release and acquire it would cost more than the take.
    function = ctypes.PyDLL("librcl.so").rcl_take_serialized_message
    function.argtypes = [ctypes.c_void_p] * 4
    function.restype = ctypes.c_int
    return function


Taken = tuple[bytes | memoryview, int, int, int, bytes]
"""(data, received_ns, source_ns, sequence, gid) of a serialized message.

The times are of the wall clock. `gid` (16 bytes) identifies the publisher, which numbers its
messages: a gap in `sequence` is a lost message. A plain tuple is faster than a named one.
"""


# rmw_message_info_t: source and received timestamp, publication and reception sequence number,
# then rmw_gid_t: the name of the middleware (a pointer) and 16 bytes.
_MESSAGE_INFO = struct.Struct("@qqQQP16s")
_MESSAGE_INFO_SIZE = 72
_HEAD = struct.Struct("@NNN")
"""The first three fields of a SerializedMessage."""
_UNSUPPORTED = 2**64 - 1
"""RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED"""


LARGE_BYTES = 1 << 20
"""A message above this size is passed as a view, not as a copy, if views are asked for."""

KEPT_BYTES = 64 << 20
"""Limit on the total size of the buffers above LARGE_BYTES that this process keeps for the next
large messages; a buffer beyond the limit is freed after its message."""


class SerializedTaker:
    """Takes the serialized messages of one subscription, through one reused buffer.

    Each message comes with its publisher's gid: without the gid, sequence numbers mean nothing on a
    topic with two publishers. All SerializedTakers together keep at most KEPT_BYTES.
    """

    _kept_by_all = 0
    """Total size [bytes] of the large buffers that all SerializedTakers keep."""

    __slots__ = (
        "_bare",
        "_buffer",
        "_capacity",
        "_head",
        "_info",
        "_info_address",
        "_info_memory",
        "_kept",
        "_message",
        "_message_address",
        "_pointer",
        "_take",
        "_views",
        "lent",
    )

    def __init__(self, pointer: int, *, views: bool = False, bare: bool = False) -> None:
        """Take from the rcl_subscription_t at `pointer`, which must outlive this object.

        With `views`, `take` returns large data as a memoryview, which is valid until the next
        `take`. With `bare`, `take` returns only the data, without times and gid: this is faster.
        """
        self._bare = bare
        self._views = views
        self.lent: memoryview | None = None
        """The view of the last large message; the next take releases the view."""
        self._kept = 0
        self._pointer = pointer
        self._take = _take_serialized()
        self._message = rcutils.SerializedMessage(allocator=rcutils.default_allocator())
        self._message_address = ctypes.addressof(self._message)
        self._head = memoryview(self._message).cast("B")
        self._info_memory = ctypes.create_string_buffer(_MESSAGE_INFO_SIZE)
        self._info = memoryview(self._info_memory).cast("B")
        self._info_address = ctypes.addressof(self._info_memory)
        self._capacity = 0
        self._buffer: Any = None

    def take(self) -> Taken | bytes | memoryview | None:
        """Return the next message, None if none waits: a `Taken` or, with `bare`, only the data.

        Raises:
            RclCallFailed: rcl could not take the message.
        """
        if self.lent is not None:
            self._end_large()
        code = self._take(self._pointer, self._message_address, self._info_address, None)
        if code == _RET_OK:
            address, length, capacity = _HEAD.unpack_from(self._head)
            if capacity != self._capacity or self._buffer is None:
                self._capacity = capacity
                self._buffer = (ctypes.c_char * capacity).from_address(address)
            data = self._buffer[:length] if length <= LARGE_BYTES else self._lend(length)
            if self._bare:
                return data
            source_ns, received_ns, sequence, _, _, gid = _MESSAGE_INFO.unpack_from(self._info)
            return data, received_ns, source_ns, sequence, gid
        if code == _RET_SUBSCRIPTION_TAKE_FAILED:
            return None
        raise RclCallFailed(
            f"rcl_take_serialized_message failed with {code}: {rcutils.take_error_text()}"
        )

    def info(self) -> dict[str, int | None]:
        """Return times and sequence numbers of the last message, as the dict that rclpy makes."""
        source_ns, received_ns, sent, received, _, _ = _MESSAGE_INFO.unpack_from(self._info)
        return {
            "source_timestamp": source_ns,
            "received_timestamp": received_ns,
            "publication_sequence_number": None if sent == _UNSUPPORTED else sent,
            "reception_sequence_number": None if received == _UNSUPPORTED else received,
        }

    def free(self) -> None:
        """Free the buffer; the next message that is read allocates a new one."""
        if self.lent is not None:
            self.lent.release()
        self.lent = self._buffer = None
        SerializedTaker._kept_by_all -= self._kept
        self._kept = self._capacity = 0
        rcutils.library().rcutils_uint8_array_fini(ctypes.c_void_p(self._message_address))

    def _lend(self, length: int) -> bytes | memoryview:
        view = memoryview(self._buffer).cast("B")[:length]
        self.lent = view
        return view if self._views else bytes(view)

    def _end_large(self) -> None:
        """Release `lent`; free its buffer if all kept buffers together would exceed KEPT_BYTES."""
        assert self.lent is not None
        self.lent.release()
        self.lent = None
        others = SerializedTaker._kept_by_all - self._kept
        if others + self._capacity > KEPT_BYTES:
            self.free()
        else:
            self._kept = self._capacity
            SerializedTaker._kept_by_all = others + self._kept
