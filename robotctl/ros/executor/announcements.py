"""Announcements of new data: rcl writes to an eventfd that asyncio watches.

rcl announces new data by calling a C function in a DDS thread. A *Python* function there
deadlocks: the DDS thread holds the reader's mutex and waits for the GIL, while the loop holds the
GIL and waits for the mutex (rclpy 1722). So the function is glibc's own `eventfd_write`, with the
eventfd as its user data: the DDS thread never waits for the GIL.
"""

from __future__ import annotations

import ctypes
import os
import sys
from enum import Enum
from functools import cache
from typing import Any

from rclpy.utilities import get_rmw_implementation_identifier

from robotctl.ros.executor import rcutils
from robotctl.ros.executor.errors import RclCallFailed, UnsupportedPlatform

_RET_OK = 0
_RET_UNSUPPORTED = 3


class Announcement(Enum):
    """What rcl can announce; the value is (library, function that sets the callback)."""

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
    """Check that `eventfd_write` can be rcl's callback on this platform.

    Raises:
        UnsupportedPlatform: This is not a 64-bit Linux with eventfd.
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


@cache
def counts_each_message() -> bool:
    """Return whether the middleware announces as many messages as it has, or more, never fewer.

    rmw_fastrtps does: it announces those that were not counted yet.
    """
    return str(get_rmw_implementation_identifier()) == "rmw_fastrtps_cpp"


def watch(announcement: Announcement, pointer: int, fd: int) -> None:
    """Let rcl write to the eventfd `fd` whenever the entity at `pointer` has new data.

    The descriptor must stay open until `unwatch` has returned.

    Raises:
        UnsupportedPlatform: The middleware has no such callback.
        RclCallFailed: rcl refused for another reason.
    """
    _set_callback(announcement, pointer, _eventfd_write(), fd)


def unwatch(announcement: Announcement, pointer: int) -> None:
    """End a `watch`; once this returns, no DDS thread uses the eventfd.

    Raises:
        UnsupportedPlatform: The middleware has no such callback.
        RclCallFailed: rcl refused for another reason.
    """
    _set_callback(announcement, pointer, None, None)


def _set_callback(
    announcement: Announcement, pointer: int, callback: int | None, data: int | None
) -> None:
    code = _setter(announcement)(pointer, callback, data)
    if code == _RET_OK:
        return
    reason = rcutils.take_error_text()
    if code == _RET_UNSUPPORTED:
        raise UnsupportedPlatform(
            f"the middleware does not announce new data ({announcement.name.lower()}: {reason}); "
            "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp or use an executor of rclpy"
        )
    raise RclCallFailed(f"{announcement.value[1]} failed with {code}: {reason}")


@cache
def _eventfd_write() -> int:
    address = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p).value
    assert address is not None
    return address


@cache
def _setter(announcement: Announcement) -> Any:
    library, name = announcement.value
    try:
        function = getattr(ctypes.CDLL(library), name)
    except (OSError, AttributeError) as error:
        raise UnsupportedPlatform(
            f"this ROS has no {name} ({error}); AsyncioExecutor needs ROS 2 Jazzy or newer"
        ) from error
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function
