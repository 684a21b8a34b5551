"""The nodes of one executor, and their current entities."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node


class Nodes:
    """The nodes of one executor; each holds a reference to it, as in rclpy."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._nodes: dict[Node, None] = {}

    def __iter__(self) -> Iterator[Node]:
        return iter(list(self._nodes))

    def add(self, node: Node) -> bool:
        """Add the node; return False where it was added before.

        Raises:
            RuntimeError: Another live executor has the node.
        """
        if node in self._nodes:
            return False
        other = _executor_of(node)
        if (
            other is not None
            and other is not self._executor
            and not getattr(other, "_is_shutdown", False)
        ):
            raise RuntimeError(
                f"node {node.get_fully_qualified_name()} belongs to another executor; "
                "call its remove_node first"
            )
        # Before the setter, which calls the executor's `add_node` again.
        self._nodes[node] = None
        _set_executor(node, self._executor)
        return True

    def remove(self, node: Node) -> bool:
        """Remove the node; return False where it was not added."""
        try:
            del self._nodes[node]
        except KeyError:
            return False
        if _executor_of(node) is self._executor:
            _set_executor(node, None)
        return True

    def clear(self) -> None:
        """Remove all nodes."""
        for node in self:
            self.remove(node)

    def entities(self) -> dict[Any, Node]:
        """Return every entity with its node; nodes that were destroyed are removed."""
        found: dict[Any, Node] = {}
        for node in self:
            if is_destroyed(node.handle):
                self._nodes.pop(node, None)  # Another thread may have removed it.
            else:
                found.update(dict.fromkeys(_entities_of(node), node))
        return found


def is_destroyed(handle: Any) -> bool:
    """Return whether rclpy has destroyed the object of the handle."""
    try:
        with handle:
            return False
    except InvalidHandle:
        return True


def _entities_of(node: Node) -> Iterator[Any]:
    return chain(
        node.subscriptions,
        node.timers,
        node.clients,
        node.services,
        node.guards,
        node.waitables,
    )


def _executor_of(node: Node) -> Any:
    # rclpy's types allow its own executors only.
    return node.executor


def _set_executor(node: Any, executor: Any) -> None:
    node.executor = executor
