# mypy: disallow-untyped-calls=False
"""One real message through the ctypes path, before anything depends on it."""

from __future__ import annotations

import asyncio
import os
from contextlib import ExitStack

from builtin_interfaces.msg import Time
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile
from rclpy.type_support import check_for_type_support

from robotctl.ros.executor import rcl
from robotctl.ros.executor.errors import UnsupportedPlatform
from robotctl.ros.executor.rcl import Signal

PROOF_TIMEOUT_S = 5.0

TOPIC_PREFIX = "/_asyncio_executor_proof_"
"""Of the topic over which a process proves its path to itself; the pid follows."""

_SENT = Time(sec=0x01020304, nanosec=0x05060708)
_CDR = bytes.fromhex("00010000 04030201 08070605")

_proven = False


async def prove(context: Context) -> None:
    """Send one message to ourselves and see eventfd, bytes and message info arrive as expected.

    Once a process: platform, middleware and the layout of its structures do not change later.

    Raises:
        UnsupportedPlatform: something on the path does not behave; the text says what.
    """
    global _proven
    if _proven:
        return
    rcl.check_platform()
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
    _proven = True


async def _until_announced(subscription: _rclpy.Subscription, publisher: _rclpy.Publisher) -> None:
    loop = asyncio.get_running_loop()
    announced = loop.create_future()

    def announce() -> None:
        if not announced.done():
            announced.set_result(None)

    fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
    try:
        rcl.watch(Signal.MESSAGE, subscription.pointer, fd)
        loop.add_reader(fd, announce)
        async with asyncio.timeout(PROOF_TIMEOUT_S):
            # Until the two have found each other, what is published is lost.
            while not publisher.get_subscription_count():  # noqa: ASYNC110 - nothing announces it
                await asyncio.sleep(0.001)
            publisher.publish(_SENT)
            await announced
    except TimeoutError:
        raise UnsupportedPlatform(
            f"the middleware {_rclpy.rclpy_get_rmw_implementation_identifier()} did not announce "
            f"a message to itself within {PROOF_TIMEOUT_S:g} s; if ROS is otherwise healthy here, "
            "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp or use an executor of rclpy"
        ) from None
    finally:
        rcl.unwatch(Signal.MESSAGE, subscription.pointer)
        loop.remove_reader(fd)
        os.close(fd)


def _check_take(subscription: _rclpy.Subscription) -> None:
    taker = rcl.SerializedTaker(subscription.pointer)
    try:
        taken = taker.take()
    finally:
        taker.close()
    if taken is None:
        raise UnsupportedPlatform("a message was announced and not there to be taken")
    message = rcl.Serialized(bytes(taken[0]), *taken[1:])
    if (
        message.data != _CDR
        or message.sequence != 1
        or not any(message.gid)
        or not 0 < message.source_ns <= message.received_ns
    ):
        raise UnsupportedPlatform(
            f"the middleware's structures are not those of ROS 2 Jazzy (got {message})"
        )
