"""A node with one entity of each kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import RawTap


def populate(node: Any, topic: str, on_message: Callable[[Any], object]) -> Any:
    """Create one entity of each kind on a node; return the publisher of the topic."""
    node.create_subscription(UInt64, topic, on_message, 100)
    node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 100, raw=True)
    node.create_service(SetBool, topic, lambda request, response: response)
    node.create_client(SetBool, topic)
    node.create_timer(0.001, lambda: None)
    node.create_guard_condition(lambda: None)
    return node.create_publisher(UInt64, topic, 100)
