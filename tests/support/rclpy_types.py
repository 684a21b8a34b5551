"""rclpy's `Node` with correct types.

Its own annotations allow only a callback of one argument that is not a coroutine function.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    import rclpy.node
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription

    class Node(rclpy.node.Node):
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
    from rclpy.node import Node

__all__ = ["Node"]
