"""A peer of plain rclpy: its process or context, and its node, whose callbacks run in a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from tests.support.lines import obey


class HasNode(Protocol):
    """A peer; its public methods are its commands."""

    node: Node


def run_peer(make: Callable[[], HasNode]) -> None:
    """Be the process of a peer until its commands end."""
    rclpy.init(args=[])
    peer = make()
    with spinning(peer.node):
        obey(peer)
    peer.node.destroy_node()
    rclpy.shutdown()


@contextmanager
def spinning(node: Node) -> Iterator[None]:
    """Run the callbacks of the node until the end of the block."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin)
    spinner.start()
    try:
        yield
    finally:
        executor.shutdown()
        spinner.join()


@contextmanager
def node_in(domain_id: int, name: str) -> Iterator[Node]:
    """Make a node in a context of its own, and run its callbacks until the end of the block."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain_id)
    node = Node(name, context=context)
    try:
        with spinning(node):
            yield node
    finally:
        node.destroy_node()
        context.try_shutdown()
