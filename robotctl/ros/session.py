"""One rclpy context with its executor for an `async with` block; it handles no signals."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager

from rclpy.context import Context
from rclpy.node import Node

from robotctl.ros.context import close_context, open_context
from robotctl.ros.executor import AsyncioExecutor, ExceptionHandler

RECORDER_NODE = "recorder"
"""The name of the node whose subscriptions only record."""


class Session:
    """Creates nodes whose callbacks run in the loop until the session ends."""

    def __init__(
        self, context: Context, executor: AsyncioExecutor, namespace: str, nodes: list[Node]
    ) -> None:
        """Add the created nodes to `nodes`."""
        self._context = context
        self._executor = executor
        self._namespace = namespace
        self._nodes = nodes
        self.last = AsyncExitStack()
        """Closed when no callback runs any more, before the nodes are destroyed."""

    @property
    def scheduling(self) -> str:
        """How the operating system schedules the loop's thread, in words."""
        return self._executor.scheduling

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic that may be relative to the robot's namespace."""
        return topic if topic.startswith("/") else f"{self._namespace}/{topic}"

    def node(self, name: str) -> Node:
        """Create a node in the robot's namespace, without parameter services."""
        node = Node(
            name,
            context=self._context,
            namespace=self._namespace,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._nodes.append(node)
        self._executor.add_node(node)
        return node


@asynccontextmanager
async def ros_session(
    *,
    domain_id: int,
    namespace: str,
    at_end: ExitStack,
    on_exception: ExceptionHandler | None = None,
    fifo_priority: int | None = None,
) -> AsyncIterator[Session]:
    """Open a context in ROS domain `domain_id`; no callback runs after the block.

    The context itself stays until `at_end` is closed, which must be the last thing that the
    process does (see `close_context`). `fifo_priority` requests SCHED_FIFO (1..99) for the loop's
    thread.
    """
    nodes: list[Node] = []
    context = open_context(domain_id)
    at_end.callback(close_context, context, nodes)
    executor = AsyncioExecutor(context, on_exception=on_exception, fifo_priority=fifo_priority)
    session = Session(context, executor, namespace, nodes)
    async with session.last, executor:
        yield session
