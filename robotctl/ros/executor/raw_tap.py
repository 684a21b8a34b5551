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
"""A serialized message. A memoryview (above 1 MiB) is valid only during the call of the sink."""

Sink = Callable[[bytes, int, int, int, bytes], object]
"""Called with (data, received_ns, source_ns, sequence, gid) for each message."""

ViewSink = Callable[[SerializedData, int, int, int, bytes], object]
"""A `Sink` that accepts memoryviews of large messages, and copies all that it keeps."""

UNKNOWN_GID = b""
"""The gid of messages of an unknown publisher."""


class RawTap:
    """A callback for a raw subscription that passes each message and its origin to `sink`.

        node.create_subscription(msg_type, topic, RawTap(sink), qos, raw=True)

    `sink` gets the serialized message, the wall-clock times [ns] of reception and publication, and
    the number and gid (16 bytes) of its publisher. A gap in the numbers of one gid is a lost
    message. `sink` must not be async. With `views`, it gets large messages as memoryviews, valid
    only during the call. In an executor of rclpy, the gid is `UNKNOWN_GID`.
    """

    __slots__ = ("__weakref__", "latency_s", "poll", "sink", "views")

    def __init__(self, sink: Sink, *, latency_s: float | None = 0.01, views: bool = False) -> None:
        """Call `sink` at most about `latency_s` seconds late, or only by `poll` if that is None."""
        self.sink = sink
        self.latency_s = latency_s
        self.views = views
        self.poll: Callable[[], None] = lambda: None
        """Passes the messages that have arrived to `sink`. Needs an AsyncioExecutor."""

    def __call__(self, data: bytes, info: Mapping[str, Any]) -> None:
        """Pass a message to `sink`. An executor of rclpy calls this."""
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


# A plain tuple is faster than a named one.
Taken = tuple[bytes | memoryview, int, int, int, bytes]
"""(data, received_ns, source_ns, sequence, gid) of a message, as a `Sink` gets them."""


# rmw_message_info_t: source and received timestamp, publication and reception sequence number,
# then rmw_gid_t: the name of the middleware (a pointer) and 16 bytes.
_MESSAGE_INFO = struct.Struct("@qqQQP16s")
_MESSAGE_INFO_SIZE = 72
_HEAD = struct.Struct("@NNN")
"""The first three fields of a SerializedMessage."""
_UNSUPPORTED = 2**64 - 1
"""RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED"""


LARGE_BYTES = 1 << 20
"""A message above this size is passed as a view where views are asked for."""

KEPT_BYTES = 64 << 20
"""Limit on all buffers above LARGE_BYTES that this process keeps for later messages."""


class SerializedTaker:
    """Takes the serialized messages of one subscription, through one reused buffer."""

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

        With `views`, large data are a memoryview, valid until the next `take`. With `bare`, `take`
        returns only the data.
        """
        self._bare = bare
        self._views = views
        self.lent: memoryview | None = None
        """The view of the last large message, which the next `take` releases."""
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
        """Return the next message, or None if none waits.

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
        """Free the buffer. The next `take` allocates a new one."""
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
        """Release `lent`, and free its buffer if all kept buffers would exceed KEPT_BYTES."""
        assert self.lent is not None
        self.lent.release()
        self.lent = None
        others = SerializedTaker._kept_by_all - self._kept
        if others + self._capacity > KEPT_BYTES:
            self.free()
        else:
            self._kept = self._capacity
            SerializedTaker._kept_by_all = others + self._kept
