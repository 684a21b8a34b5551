"""A peer of plain rclpy that reads and sets parameters and log levels, in a process of its own."""

from __future__ import annotations

import time
from typing import Any

from rcl_interfaces.msg import Log, LoggerLevel, ParameterEvent
from rcl_interfaces.srv import GetLoggerLevels, SetLoggerLevels
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile

from tests.support.spinning import run_peer
from tests.support.waiting import DEADLINE_S, until

ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Peer:
    def __init__(self) -> None:
        self.node = Node("somebody_else", start_parameter_services=False)
        self.changed: list[tuple[str, str, Any]] = []
        self.node.create_subscription(ParameterEvent, "/parameter_events", self._changed, 1000)
        self._clients: dict[str, AsyncParameterClient] = {}
        self.logged: list[tuple[int, str, str]] = []
        self.node.create_subscription(Log, "/rosout", self._logged, ROSOUT)

    def _changed(self, event: Any) -> None:
        for each in event.changed_parameters:
            self.changed.append((event.node, each.name, parameter_value_to_python(each.value)))

    def _logged(self, line: Any) -> None:
        self.logged.append((line.level, line.name, line.msg))

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

    def lines(self) -> list[tuple[int, str, str]]:
        """Return the log lines on /rosout: level, logger, text."""
        return self.logged

    def levels(self, node: str, names: list[str]) -> list[int]:
        """Return the levels of loggers."""
        request = GetLoggerLevels.Request(names=names)
        answer = self._ask(GetLoggerLevels, f"{node}/get_logger_levels", request)
        return [each.level for each in answer.levels]

    def set_levels(self, node: str, levels: dict[str, int]) -> list[tuple[bool, str]]:
        """Set the levels of loggers; return for each whether that was granted, and why not."""
        wanted = [LoggerLevel(name=name, level=level) for name, level in levels.items()]
        request = SetLoggerLevels.Request(levels=wanted)
        answer = self._ask(SetLoggerLevels, f"{node}/set_logger_levels", request)
        return [(each.successful, each.reason) for each in answer.results]

    def events(self) -> list[tuple[str, str, Any]]:
        """Return the changes that were published: node, key, value."""
        return self.changed

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._clients:
            client = AsyncParameterClient(self.node, node)
            assert client.wait_for_services(DEADLINE_S), f"{node} has no parameter services"
            self._clients[node] = client
        return self._clients[node]

    def _ask(self, kind: Any, service: str, request: Any) -> Any:
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(DEADLINE_S), f"no service {service}"
        answer = self._done(client.call_async(request))
        self.node.destroy_client(client)
        return answer

    def _done(self, future: Any) -> Any:
        until(future.done)
        return future.result()


if __name__ == "__main__":
    run_peer(Peer)
