"""The graph that a node sees, as JSON objects for `robotctl topic|node|service`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node

from robotctl.ros.graph import endpoints
from robotctl.ros.graph.endpoints import LOOK_NODE, Endpoint, full_name
from robotctl.ros.messages import qos

MAX_NAMES = 5000
"""Limit on the topics, on the services and on the nodes; other processes may create any number."""

_REQUEST_TOPIC = re.compile(r"rq(/.+)Request")
_REQUEST_TYPE = re.compile(r"(\w+)::srv::dds_::(\w+)_Request_|(\w+)::action::dds_::(\w+)_Request_")


def overview(node: Node) -> dict[str, Any]:
    """Return the names of all topics and services with their types, and the names of all nodes.

    Nodes of `robotctl topic|node|service` commands, including this one, are left out.
    `left_out` counts the names beyond MAX_NAMES.
    """
    found: dict[str, list[Any]] = {
        "topics": _typed(endpoints.topics(node)),
        "services": _typed(services(node)),
        "nodes": sorted(name for name in endpoints.node_names(node) if f"/{LOOK_NODE}" not in name),
    }
    return {
        **{kind: names[:MAX_NAMES] for kind, names in found.items()},
        "left_out": sum(max(len(names) - MAX_NAMES, 0) for names in found.values()),
    }


def topic_facts(node: Node, topic: str) -> dict[str, Any]:
    """Return types, publishers and subscriptions of a topic; `topic` is its full name.

    Each endpoint has its node's full name ("" while unknown), its type, gid and QoS.
    """
    names = topic.encode(errors="surrogateescape").decode(errors="backslashreplace")
    publishers = endpoints.publishers(node, topic)[:MAX_NAMES]
    subscriptions = endpoints.subscriptions(node, topic)[:MAX_NAMES]
    return {
        "name": names,
        "types": sorted({each.topic_type for each in (*publishers, *subscriptions)}),
        "publishers": list(map(_endpoint, publishers)),
        "subscriptions": list(map(_endpoint, subscriptions)),
    }


def node_facts(node: Node, name: str) -> dict[str, Any] | None:
    """Return what the node with this full name publishes, subscribes to, serves and calls.

    None if no such node is discovered.
    """
    namespace, _, base = name.rpartition("/")
    try:
        with node.handle:
            lists = {
                key: _typed(dict(list_of(node.handle, *extra, base, namespace or "/")))
                for key, (list_of, extra) in _LISTS.items()
            }
    except (_rclpy.NodeNameNonExistentError, TypeError, UnicodeDecodeError):  # or not UTF-8
        return None
    return {"name": name, **lists}


_LISTS: Mapping[str, tuple[Any, tuple[Any, ...]]] = {
    "publishers": (_rclpy.rclpy_get_publisher_names_and_types_by_node, (False,)),
    "subscriptions": (_rclpy.rclpy_get_subscriber_names_and_types_by_node, (False,)),
    "servers": (_rclpy.rclpy_get_service_names_and_types_by_node, ()),
    "clients": (_rclpy.rclpy_get_client_names_and_types_by_node, ()),
}


def _typed(names: Mapping[str, Iterable[str]]) -> list[dict[str, Any]]:
    return [
        {
            "name": name.encode(errors="surrogateescape").decode(errors="backslashreplace"),
            "types": sorted(types),
        }
        for name, types in sorted(names.items())
    ]


def services(node: Node) -> dict[str, set[str]]:
    """Return service name -> types, for every service whose request topic is discovered in DDS."""
    found: dict[str, set[str]] = {}
    for topic, types in endpoints.topics(node, dds_names=True).items():
        if match := _REQUEST_TOPIC.fullmatch(topic):
            found.setdefault(match[1], set()).update(map(_service_type, types))
    return found


def _service_type(dds_type: str) -> str:
    match = _REQUEST_TYPE.fullmatch(dds_type)
    if match is None:
        return dds_type
    return f"{match[1]}/srv/{match[2]}" if match[1] else f"{match[3]}/action/{match[4]}"


def _endpoint(endpoint: Endpoint) -> dict[str, Any]:
    return {
        "node": full_name(endpoint),
        "type": endpoint.topic_type,
        "gid": endpoint.gid.hex("."),
        "qos": qos.words(endpoint.qos_profile),
    }
