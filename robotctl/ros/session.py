"""Opens an rclpy context with an executor for the daemon's nodes, without signal handlers."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from types import MappingProxyType
from typing import TypeVar

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from robotctl.ros.context import close_context, open_context
from robotctl.ros.executor import AsyncioExecutor, ExceptionHandler

RECORDER_NODE = "_recorder"
"""The name of the hidden node, whose subscriptions only record and watch."""

SERVICE_EVENTS = "/_service_event"
"""Suffix of the introspection topic of a service."""


N = TypeVar("N", bound=Node)


class Session:
    """Creates nodes whose callbacks run in the loop until the session ends."""

    def __init__(
        self,
        context: Context,
        executor: AsyncioExecutor,
        namespace: str,
        nodes: list[Node],
        remaps: Sequence[str],
        node_names: Mapping[str, str],
        use_sim_time: bool,
    ) -> None:
        """Create nodes in `namespace`, and append each to `nodes`."""
        self._context = context
        self.executor = executor
        self._namespace = namespace
        self._nodes = nodes
        self._node_names = node_names
        self._remaps = remaps
        self._overrides = [
            Parameter("start_type_description_service", value=False),
            Parameter("use_sim_time", value=use_sim_time),
        ]
        self.visible_nodes: dict[str, Node] = {}
        """The nodes that ROS tools show, by their default names (before `--ros-args`)."""

        self.last = AsyncExitStack()
        """Exit stack to close after the last callback, before the nodes are destroyed."""

    def resolve(self, topic: str, role: str = "") -> str:
        """Return the full name of a topic or service after remapping.

        `role` is the default name of the node that uses it. Rules for that node alone apply too.
        """
        # Introspection topics are remapped as their service.
        service = topic.removesuffix(SERVICE_EVENTS)
        name = self._remapped(service, self._node_names.get(role, role))
        return name if service == topic else name + SERVICE_EVENTS

    def _remapped(self, topic: str, node: str) -> str:
        """Return the full name of `topic` after the first rule that matches, as in rcl."""

        def full(name: str) -> str:
            return str(self.helper().resolve_topic_name(name, only_expand=True))

        for rule in self._remaps:
            left, _, target = rule.partition(":=")
            only, _, source = left.rpartition(":")
            if only in ("", node) and full(source) == full(topic):
                return full(target)
        return full(topic)

    def logger_name(self, node_name: str) -> str:
        """Return the ROS logger name of the node with the default name `node_name`."""
        full = f"{self._namespace}/{self._node_names.get(node_name, node_name)}"
        return full.strip("/").replace("/", ".")

    def helper(self) -> Node:
        """Return the hidden node `_recorder`, which all callers share. Create it if needed."""
        for node in self._nodes:
            if node.get_name() == RECORDER_NODE:
                return node
        return self.node(RECORDER_NODE)

    def node(self, name: str) -> Node:
        """Create a node with the default name `name`, without rclpy's default services."""
        return self.node_of(Node, name)

    def node_of(self, kind: type[N], name: str) -> N:
        """Create a node of class `kind` with the default name `name`, without rclpy's services."""
        # The type description service would take 0.1 MB per node, and no ROS tool calls it.
        node = kind(
            self._node_names.get(name, name),
            context=self._context,
            namespace=self._namespace,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=self._overrides,
        )
        if not name.startswith("_"):
            self.visible_nodes[name] = node
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def remove(self, node: Node) -> None:
        """Destroy a node before the session ends."""
        self.executor.remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()


@asynccontextmanager
async def ros_session(
    *,
    domain_id: int,
    namespace: str,
    at_end: ExitStack,
    on_exception: ExceptionHandler | None = None,
    fifo_priority: int | None = None,
    remaps: Sequence[str] = (),
    node_names: Mapping[str, str] = MappingProxyType({}),
    use_sim_time: bool = False,
) -> AsyncIterator[Session]:
    """Open a session in ROS domain `domain_id`. No callback runs after the block.

    The ROS context stays open until the caller closes `at_end`, as its process's last step.
    `remaps` are rules FROM:=TO for topics and services. `node_names` maps default names of nodes to
    names on ROS. `fifo_priority` requests SCHED_FIFO (1..99) for the loop's thread.
    """
    nodes: list[Node] = []
    context = open_context(domain_id, remaps)
    at_end.callback(close_context, context, nodes)
    executor = AsyncioExecutor(context, on_exception=on_exception, fifo_priority=fifo_priority)
    session = Session(context, executor, namespace, nodes, remaps, node_names, use_sim_time)
    async with session.last, executor:
        yield session
