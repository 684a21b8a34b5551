"""Changes of the graph are announced, and a calm graph wakes nobody."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

from robotctl.ros.graph.changes import GraphChanges
from tests.support.waiting import DEADLINE_S


async def settled(changes: GraphChanges) -> None:
    """Wait until nothing of earlier tests changes the graph any more."""
    async with asyncio.timeout(DEADLINE_S):
        while await changes.wait(0.5):
            pass


async def test_a_topic_of_another_process_is_a_change_and_a_calm_graph_has_none(
    node: Any, new_context: Callable[[], Any]
) -> None:
    from rclpy.node import Node
    from std_msgs.msg import UInt64

    other = Node("other", context=new_context())
    with GraphChanges(node) as changes:
        await settled(changes)
        published = other.create_publisher(UInt64, "changing", 10)
        assert await changes.wait(DEADLINE_S)
        await settled(changes)
        other.destroy_publisher(published)
        assert await changes.wait(DEADLINE_S)
    other.destroy_node()


async def test_a_change_before_the_wait_is_not_missed(node: Any) -> None:
    from std_msgs.msg import UInt64

    with GraphChanges(node) as changes:
        await settled(changes)
        node.create_publisher(UInt64, "early", 10)
        await asyncio.sleep(0)
        assert await changes.wait(DEADLINE_S)


async def test_its_thread_ends_with_the_block_whatever_it_waits_for(node: Any) -> None:
    from std_msgs.msg import UInt64

    with GraphChanges(node) as changes:
        await settled(changes)  # the thread waits for a change
    with GraphChanges(node):
        node.create_publisher(UInt64, "late", 10)  # the thread waits to be asked
    assert "graph changes" not in {thread.name for thread in threading.enumerate()}
