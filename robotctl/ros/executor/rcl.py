"""The edge to rcl: the few C calls that AsyncioExecutor needs and rclpy does not offer.

rcl tells about new data by calling a C function in a DDS thread. A *Python* function there
deadlocks (the DDS thread holds the reader's mutex and waits for the GIL; the loop holds the GIL
and waits for the mutex: rclpy 1722). So the function is glibc's own `eventfd_write`, with the
eventfd as its user data: the DDS thread never meets the GIL, and asyncio watches the eventfd.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from enum import Enum
from functools import cache
from typing import Any, NamedTuple

from robotctl.ros.executor.errors import RclCallFailed, UnsupportedPlatform

_RET_OK = 0
_RET_UNSUPPORTED = 3
_RET_SUBSCRIPTION_TAKE_FAILED = 401


class Signal(Enum):
    """What rcl can announce, as (library, function that sets the callback)."""

    MESSAGE = ("librcl.so", "rcl_subscription_set_on_new_message_callback")
    REQUEST = ("librcl.so", "rcl_service_set_on_new_request_callback")
    RESPONSE = ("librcl.so", "rcl_client_set_on_new_response_callback")
    QOS_EVENT = ("librcl.so", "rcl_event_set_callback")
    TIMER_RESET = ("librcl.so", "rcl_timer_set_on_reset_callback")
    GOAL_REQUEST = ("librcl_action.so", "rcl_action_server_set_goal_service_callback")
    CANCEL_REQUEST = ("librcl_action.so", "rcl_action_server_set_cancel_service_callback")
    RESULT_REQUEST = ("librcl_action.so", "rcl_action_server_set_result_service_callback")
    GOAL_RESPONSE = ("librcl_action.so", "rcl_action_client_set_goal_client_callback")
    CANCEL_RESPONSE = ("librcl_action.so", "rcl_action_client_set_cancel_client_callback")
    RESULT_RESPONSE = ("librcl_action.so", "rcl_action_client_set_result_client_callback")
    FEEDBACK = ("librcl_action.so", "rcl_action_client_set_feedback_subscription_callback")
    STATUS = ("librcl_action.so", "rcl_action_client_set_status_subscription_callback")


def check_platform() -> None:
    """Refuse a platform where `eventfd_write` cannot stand in for rcl's callback.

    Raises:
        UnsupportedPlatform: not a 64-bit Linux with eventfd.
    """
    if not sys.platform.startswith("linux") or not hasattr(os, "eventfd"):
        raise UnsupportedPlatform(
            f"AsyncioExecutor needs Linux with eventfd, and this is {sys.platform}; "
            "use an executor of rclpy here"
        )
    if ctypes.sizeof(ctypes.c_void_p) != 8:
        # eventfd_write(int, uint64_t) takes the arguments of callback(const void *, size_t)
        # in the same registers only where both pointers and sizes have 64 bits.
        raise UnsupportedPlatform(
            "AsyncioExecutor needs a 64-bit Python; use an executor of rclpy here"
        )


def watch(signal: Signal, pointer: int, fd: int) -> None:
    """Let rcl write to the eventfd `fd` whenever the entity at `pointer` has something new.

    The descriptor must stay open until `unwatch` has returned.

    Raises:
        UnsupportedPlatform: the middleware has no such callback.
        RclCallFailed: rcl refused for another reason.
    """
    _set_callback(signal, pointer, _eventfd_write(), fd)


def unwatch(signal: Signal, pointer: int) -> None:
    """End what `watch` began; once this returns, no DDS thread touches the eventfd."""
    _set_callback(signal, pointer, None, None)


def _set_callback(signal: Signal, pointer: int, callback: int | None, data: int | None) -> None:
    code = _setter(signal)(pointer, callback, data)
    if code == _RET_OK:
        return
    reason = take_error_text()
    if code == _RET_UNSUPPORTED:
        raise UnsupportedPlatform(
            f"the middleware does not announce new data ({signal.name.lower()}: {reason}); "
            "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp or use an executor of rclpy"
        )
    raise RclCallFailed(f"{signal.value[1]} failed with {code}: {reason}")


@cache
def _eventfd_write() -> int:
    address = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p).value
    assert address is not None
    return address


@cache
def _setter(signal: Signal) -> Any:
    library, name = signal.value
    try:
        function = getattr(ctypes.CDLL(library), name)
    except (OSError, AttributeError) as error:
        raise UnsupportedPlatform(
            f"this ROS has no {name} ({error}); AsyncioExecutor needs ROS 2 Jazzy or newer"
        ) from error
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function


class _ErrorString(ctypes.Structure):
    _fields_ = (("text", ctypes.c_char * 1024),)


class Allocator(ctypes.Structure):
    """rcutils_allocator_t"""

    _fields_ = tuple(
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    )


class _SerializedMessage(ctypes.Structure):
    """rcutils_uint8_array_t"""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", Allocator),
    )


@cache
def rcutils() -> Any:
    """The library of allocators and error texts; the GIL is kept."""
    library = ctypes.PyDLL("librcutils.so")
    library.rcutils_get_default_allocator.restype = Allocator
    library.rcutils_get_error_string.restype = _ErrorString
    return library


def take_error_text() -> str:
    """rcl's reason for the last failure in this thread, which is then forgotten."""
    library = rcutils()
    text: bytes = library.rcutils_get_error_string().text
    library.rcutils_reset_error()
    return text.decode(errors="replace")


@cache
def _take_serialized() -> Any:
    # PyDLL keeps the GIL: giving it up and fetching it again would cost more than the take.
    function = ctypes.PyDLL("librcl.so").rcl_take_serialized_message
    function.argtypes = [ctypes.c_void_p] * 4
    function.restype = ctypes.c_int
    return function


class Serialized(NamedTuple):
    """One message as it came over the wire, and what the middleware knows about it.

    received_ns and source_ns are wall-clock nanoseconds; sequence counts the messages of the
    publisher that gid (16 bytes) names, so a gap in it is a lost message.
    """

    data: bytes
    received_ns: int
    source_ns: int
    sequence: int
    gid: bytes


# rmw_message_info_t: source and received timestamp, publication and reception sequence number,
# then rmw_gid_t: the name of the middleware (a pointer) and 16 bytes.
_MESSAGE_INFO = struct.Struct("@qqQQP16s")
_MESSAGE_INFO_SIZE = 72
_UNSUPPORTED = 2**64 - 1
"""RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED"""


LARGE_BYTES = 1 << 20
"""Messages above this are lent out as a view where that is asked for, instead of copied."""

KEPT_BYTES = 64 << 20
"""What all takers of the process keep of buffers above LARGE_BYTES; more is given back at once, and
has to be allocated again for the next message."""


class SerializedTaker:
    """Takes serialized messages, with all that the middleware knows, through one reused buffer.

    rclpy's own take hides the publisher's gid, without which sequence numbers say nothing where
    a topic has two publishers. The buffer grows to the largest message, within KEPT_BYTES for all.
    """

    _kept_by_all = 0
    """Bytes of large buffers that takers keep."""

    __slots__ = (
        "_buffer",
        "_capacity",
        "_head",
        "_info",
        "_info_address",
        "_info_memory",
        "_kept",
        "_lent",
        "_message",
        "_message_address",
        "_pointer",
        "_take",
        "_views",
    )

    def __init__(self, pointer: int, *, views: bool = False) -> None:
        """Take from the rcl_subscription_t at `pointer`, which must outlive this object.

        With `views` large messages are memoryviews that are valid until the next take.
        """
        self._views = views
        self._lent: memoryview | None = None
        self._kept = 0
        self._pointer = pointer
        self._take = _take_serialized()
        self._message = _SerializedMessage(allocator=rcutils().rcutils_get_default_allocator())
        self._message_address = ctypes.addressof(self._message)
        self._head = (ctypes.c_size_t * 3).from_buffer(self._message)
        self._info_memory = ctypes.create_string_buffer(_MESSAGE_INFO_SIZE)
        self._info = memoryview(self._info_memory).cast("B")
        self._info_address = ctypes.addressof(self._info_memory)
        self._capacity = 0
        self._buffer: Any = None

    def take(self) -> tuple[bytes | memoryview, int, int, int, bytes] | None:
        """The next message as (data, received_ns, source_ns, sequence, gid), or None.

        A plain tuple in the order of `Serialized`: this runs up to 45,000 times a second.

        Raises:
            RclCallFailed: the middleware could not hand over the message.
        """
        if self._lent is not None:
            self._end_large()
        code = self._take(self._pointer, self._message_address, self._info_address, None)
        if code == _RET_OK:
            address, length, capacity = self._head
            if capacity != self._capacity or self._buffer is None:
                self._capacity = capacity
                self._buffer = (ctypes.c_char * capacity).from_address(address)
            source_ns, received_ns, sequence, _, _, gid = _MESSAGE_INFO.unpack_from(self._info)
            data = self._buffer[:length] if length <= LARGE_BYTES else self._lend(length)
            return data, received_ns, source_ns, sequence, gid
        if code == _RET_SUBSCRIPTION_TAKE_FAILED:
            return None
        raise RclCallFailed(f"rcl_take_serialized_message failed with {code}: {take_error_text()}")

    def info(self) -> dict[str, int | None]:
        """What rclpy tells a callback of two arguments, about the message that was taken last."""
        source_ns, received_ns, sent, received, _, _ = _MESSAGE_INFO.unpack_from(self._info)
        return {
            "source_timestamp": source_ns,
            "received_timestamp": received_ns,
            "publication_sequence_number": None if sent == _UNSUPPORTED else sent,
            "reception_sequence_number": None if received == _UNSUPPORTED else received,
        }

    def close(self) -> None:
        """Give the buffer back; the object takes nothing any more."""
        self._free()

    def _lend(self, length: int) -> bytes | memoryview:
        view = memoryview(self._buffer).cast("B")[:length]
        self._lent = view
        return view if self._views else bytes(view)

    def _end_large(self) -> None:
        """End the view, and keep the buffer only where it fits beside those of the others."""
        assert self._lent is not None
        self._lent.release()
        self._lent = None
        others = SerializedTaker._kept_by_all - self._kept
        if others + self._capacity > KEPT_BYTES:
            self._free()
        else:
            self._kept = self._capacity
            SerializedTaker._kept_by_all = others + self._kept

    def _free(self) -> None:
        if self._lent is not None:
            self._lent.release()
        self._lent = self._buffer = None
        SerializedTaker._kept_by_all -= self._kept
        self._kept = self._capacity = 0
        rcutils().rcutils_uint8_array_fini(self._message_address_argument())

    def _message_address_argument(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self._message_address)
