"""A peer with plain rclpy's parameter client, in a process of its own."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from tests.support.lines import obey
from tests.support.spinning import spinning
from tests.support.waiting import DEADLINE_S, until


class Peer:
    def __init__(self) -> None:
        self.node = Node("somebody_else", start_parameter_services=False)
        self.changed: list[tuple[str, str, Any]] = []
        self.node.create_subscription(ParameterEvent, "/parameter_events", self._changed, 1000)
        self._clients: dict[str, AsyncParameterClient] = {}

    def _changed(self, event: Any) -> None:
        for each in event.changed_parameters:
            self.changed.append((event.node, each.name, parameter_value_to_python(each.value)))

    def visible(self) -> list[str]:
        """Return the full names of the other nodes that `ros2 node list` shows."""
        found = self.node.get_node_names_and_namespaces()
        names = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found if name[0] != "_"}
        return sorted(names - {"/somebody_else"})

    def list_all(self) -> dict[str, Any]:
        """List the parameters of every visible node, one after the other as `ros2 param list`."""
        nodes = self.visible()
        for node in nodes:
            self._client(node)
        begin = time.monotonic()
        keys = {
            node: sorted(self._done(self._client(node).list_parameters()).result.names)
            for node in nodes
        }
        return {"keys": keys, "took_s": time.monotonic() - begin}

    def get(self, node: str, keys: list[str]) -> list[Any]:
        """Return the values of keys."""
        values = self._done(self._client(node).get_parameters(keys)).values
        return [parameter_value_to_python(value) for value in values]

    def describe(self, node: str, key: str) -> dict[str, Any]:
        """Return what a node says about a key."""
        (told,) = self._done(self._client(node).describe_parameters([key])).descriptors
        limits = [*told.floating_point_range, *told.integer_range]
        return {
            "type": told.type,
            "about": told.description,
            "allowed": told.additional_constraints,
            "read_only": told.read_only,
            "range": [(each.from_value, each.to_value) for each in limits],
        }

    def set(self, node: str, values: dict[str, Any], atomically: bool = False) -> Any:
        """Set keys; return for each whether that was granted, and the reason why not."""
        parameters = [Parameter(key, value=value) for key, value in values.items()]
        if atomically:
            result = self._done(self._client(node).set_parameters_atomically(parameters)).result
            return [(result.successful, result.reason)]
        results = self._done(self._client(node).set_parameters(parameters)).results
        return [(result.successful, result.reason) for result in results]

    def events(self) -> list[tuple[str, str, Any]]:
        """Return the changes that were published: node, key, value."""
        return self.changed

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._clients:
            client = AsyncParameterClient(self.node, node)
            assert client.wait_for_services(DEADLINE_S), f"{node} has no parameter services"
            self._clients[node] = client
        return self._clients[node]

    def _done(self, future: Any) -> Any:
        until(future.done)
        return future.result()


def main() -> None:
    rclpy.init(args=[])
    peer = Peer()
    with spinning(peer.node):
        obey(peer)
    peer.node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
