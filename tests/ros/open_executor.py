"""rclpy's `Node` with correct types; the inside of an open AsyncioExecutor; descriptors."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap
from robotctl.ros.executor.engine import Engine
from robotctl.ros.executor.runtime import Runtime

if TYPE_CHECKING:
    import rclpy.node
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription

    class Node(rclpy.node.Node):
        """Its own annotations allow only callbacks of one argument that are no coroutines."""

        def create_subscription(
            self,
            msg_type: Any,
            topic: str,
            callback: Callable[..., object],
            qos_profile: QoSProfile | int,
            **options: Any,
        ) -> Subscription: ...

        def destroy_node(self) -> None: ...

else:
    from rclpy.node import Node as Node


def engine_of(executor: AsyncioExecutor) -> Engine:
    """Return the part of it that exists while it is open."""
    assert executor._engine is not None
    return executor._engine


def sources_of(executor: AsyncioExecutor) -> dict[Any, Any]:
    """Return its sources, by entity; what a source has depends on its kind."""
    return engine_of(executor).sources


def runtime_of(executor: AsyncioExecutor) -> Runtime:
    """Return the state that its sources share."""
    return engine_of(executor).runtime


def populate(node: Any, topic: str, on_message: Callable[[Any], object]) -> Any:
    """Create one entity of each kind on a node; return the publisher of the topic."""
    node.create_subscription(UInt64, topic, on_message, 100)
    node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 100, raw=True)
    node.create_service(SetBool, topic, lambda request, response: response)
    node.create_client(SetBool, topic)
    node.create_timer(0.001, lambda: None)
    node.create_guard_condition(lambda: None)
    return node.create_publisher(UInt64, topic, 100)


def loop_descriptors() -> int:
    """Count the open descriptors of the kinds that an executor or a ticker waits on.

    Others are not counted: the middleware's threads open and close shared memory at any moment.
    """
    count = 0
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # it was closed after it was listed
            count += os.readlink(descriptor).startswith("anon_inode:")
    return count
