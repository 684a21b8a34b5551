"""Announcements of new data, which rcl writes to an eventfd."""

from __future__ import annotations

import asyncio
import ctypes
import os
import sys
from contextlib import ExitStack
from enum import Enum
from functools import cache
from typing import Any, cast

from builtin_interfaces.msg import Time
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile
from rclpy.type_support import check_for_type_support
from rclpy.utilities import get_rmw_implementation_identifier

from robotctl.ros.executor import rcutils
from robotctl.ros.executor.raw_tap import SerializedTaker, Taken
from robotctl.ros.executor.rcutils import RclCallFailed, UnsupportedPlatform

_RET_OK = 0
_RET_UNSUPPORTED = 3


class Announcement(Enum):
    """A kind of new data. Its value is (library, C function that sets rcl's callback for it)."""

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
    """Return whether the eventfd counts every message, even one that arrived before `watch`."""
    return str(get_rmw_implementation_identifier()) == "rmw_fastrtps_cpp"


def watch(announcement: Announcement, pointer: int, fd: int) -> None:
    """Make rcl write to the eventfd `fd` whenever the entity at `pointer` has new data.

    The descriptor must stay open until `unwatch` has returned.

    Raises:
        UnsupportedPlatform: The middleware has no such callback.
        RclCallFailed: rcl refused for another reason.
    """
    _set_callback(announcement, pointer, _eventfd_write(), fd)


def unwatch(announcement: Announcement, pointer: int) -> None:
    """Undo a call of `watch`. After the return, no DDS thread uses the eventfd.

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
    # A Python function would deadlock in the DDS thread (docs/design.md; rclpy issue 1722).
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


TIMEOUT_S = 5.0

TOPIC_PREFIX = "/_asyncio_executor_proof_"
"""Prefix of the topic of `check_announcements`. The process id follows."""

_SENT = Time(sec=0x01020304, nanosec=0x05060708)
_CDR = bytes.fromhex("00010000 04030201 08070605")

_passed = False


async def check_announcements(context: Context) -> None:
    """Send a test message: rcl must announce it and return its bytes. No-op after a success.

    Raises:
        UnsupportedPlatform: The check failed; the error text names the step.
    """
    global _passed
    if _passed:
        return
    check_platform()
    check_for_type_support(Time)
    topic = f"{TOPIC_PREFIX}{os.getpid()}"
    qos = QoSProfile(depth=1).get_c_qos_profile()
    with ExitStack() as entities:
        node = _rclpy.Node("_asyncio_executor_proof", "/", context.handle, None, False, False)
        entities.callback(node.destroy_when_not_in_use)
        publisher = _rclpy.Publisher(node, Time, topic, qos)
        entities.callback(publisher.destroy_when_not_in_use)
        subscription = _rclpy.Subscription(node, Time, topic, qos)
        entities.callback(subscription.destroy_when_not_in_use)
        await _until_announced(subscription, publisher)
        _check_take(subscription)
    _passed = True


async def _until_announced(subscription: _rclpy.Subscription, publisher: _rclpy.Publisher) -> None:
    loop = asyncio.get_running_loop()
    announced = loop.create_future()

    def announce() -> None:
        if not announced.done():
            announced.set_result(None)

    fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
    at_end = ExitStack()
    at_end.callback(os.close, fd)
    try:
        watch(Announcement.MESSAGE, subscription.pointer, fd)
        at_end.callback(unwatch, Announcement.MESSAGE, subscription.pointer)
        loop.add_reader(fd, announce)
        at_end.callback(loop.remove_reader, fd)
        async with asyncio.timeout(TIMEOUT_S):
            # A message is lost if publisher and subscription have not matched yet.
            while not publisher.get_subscription_count():  # noqa: ASYNC110 - no event tells it
                await asyncio.sleep(0.001)
            publisher.publish(_SENT)
            await announced
    except TimeoutError:
        raise UnsupportedPlatform(
            f"the middleware {_rclpy.rclpy_get_rmw_implementation_identifier()} did not announce "
            f"a message to itself within {TIMEOUT_S:g} s; if ROS is otherwise healthy here, "
            "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp or use an executor of rclpy"
        ) from None
    finally:
        at_end.close()


def _check_take(subscription: _rclpy.Subscription) -> None:
    taker = SerializedTaker(subscription.pointer)
    try:
        taken = taker.take()
    finally:
        taker.free()
    if taken is None:
        raise UnsupportedPlatform("a message was announced, but there was none to take")
    data, received_ns, source_ns, sequence, gid = cast(Taken, taken)
    is_right = bytes(data) == _CDR and sequence == 1 and any(gid)
    if not is_right or not 0 < source_ns <= received_ns:
        raise UnsupportedPlatform(
            f"the middleware's structures are not those of ROS 2 Jazzy (got {taken!r})"
        )
