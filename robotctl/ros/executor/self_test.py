"""Sends one real message through the ctypes path, before anything depends on it."""

from __future__ import annotations

import asyncio
import os
from contextlib import ExitStack

from builtin_interfaces.msg import Time
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile
from rclpy.type_support import check_for_type_support

from robotctl.ros.executor import announcements
from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.errors import UnsupportedPlatform
from robotctl.ros.executor.serialized_taker import SerializedTaker, TakenMessage

TIMEOUT_S = 5.0

TOPIC_PREFIX = "/_asyncio_executor_proof_"
"""Prefix of the topic on which a process tests its path; its process id follows."""

_SENT = Time(sec=0x01020304, nanosec=0x05060708)
_CDR = bytes.fromhex("00010000 04030201 08070605")

_passed = False


async def check_announcements(context: Context) -> None:
    """Check that a message of our own is announced, and taken with the expected bytes and info.

    Once per process: platform, middleware and the layout of its structures do not change later.

    Raises:
        UnsupportedPlatform: A step of the path does not work; the text says which.
    """
    global _passed
    if _passed:
        return
    announcements.check_platform()
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
        announcements.watch(Announcement.MESSAGE, subscription.pointer, fd)
        at_end.callback(announcements.unwatch, Announcement.MESSAGE, subscription.pointer)
        loop.add_reader(fd, announce)
        at_end.callback(loop.remove_reader, fd)
        async with asyncio.timeout(TIMEOUT_S):
            # Messages that are published before the two are matched are lost.
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
    message = TakenMessage(bytes(taken[0]), *taken[1:])
    if (
        message.data != _CDR
        or message.sequence != 1
        or not any(message.gid)
        or not 0 < message.source_ns <= message.received_ns
    ):
        raise UnsupportedPlatform(
            f"the middleware's structures are not those of ROS 2 Jazzy (got {message})"
        )
