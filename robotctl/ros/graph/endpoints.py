"""Topics, publishers, subscriptions, services and nodes of the domain, with any bytes as names."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.validate_full_topic_name import validate_full_topic_name

from robotctl.base.text import printable, short_name
from robotctl.ros import qos
from robotctl.ros.graph import rcl_graph
from robotctl.ros.graph.rcl_graph import Endpoint as Endpoint
from robotctl.ros.graph.rcl_graph import Gid, Role, checked, escaped, function


def topics(node: Node, *, dds_names: bool = False) -> dict[str, list[str]]:
    """Map the full name of each discovered topic to its types. `dds_names` chooses DDS names.

    Bytes that are not UTF-8 become surrogate escapes in a name, and backslash escapes in a type.
    """
    try:
        return dict(node.get_topic_names_and_types(dds_names))
    except UnicodeDecodeError:
        with node.handle:
            found = rcl_graph.topic_names_and_types(node.handle.pointer, dds_names=dds_names)
    return {
        name.decode(errors="surrogateescape"): [escaped(each) for each in types]
        for name, types in found
    }


def publishers(node: Node, topic: str, *, dds_names: bool = False) -> list[Endpoint]:
    """Return the publishers of `topic`, a full name in the form that `topics()` returns."""
    return _endpoints(node, Role.PUBLISHER, topic, dds_names)


def subscriptions(node: Node, topic: str, *, dds_names: bool = False) -> list[Endpoint]:
    """Return the subscriptions to `topic`, a full name in the form that `topics()` returns."""
    return _endpoints(node, Role.SUBSCRIPTION, topic, dds_names)


def publisher_count(node: Node, topic: str) -> int:
    """Return the number of publishers of `topic`, a full name."""
    with node.handle:
        # rclpy's `Node.count_publishers` would expand and validate the name each time.
        return int(node.handle.get_count_publishers(topic))


def subscription_count(node: Node, topic: str) -> int:
    """Return the number of subscriptions to `topic`, a full name."""
    with node.handle:
        return int(node.handle.get_count_subscribers(topic))


def node_names(node: Node) -> list[str]:
    """Return the full name of each discovered node. A name that two nodes share comes twice."""
    with node.handle:
        found = rcl_graph.node_names(node.handle.pointer)
    return [f"{escaped(space).rstrip('/')}/{escaped(name)}" for name, space in found]


def is_topic_name(name: str) -> bool:
    """Return whether ROS allows this full topic name."""
    try:
        return name.isascii() and bool(validate_full_topic_name(name))
    except InvalidTopicNameException:
        return False


_OF_RCLPY = {
    Role.PUBLISHER: _rclpy.rclpy_get_publishers_info_by_topic,
    Role.SUBSCRIPTION: _rclpy.rclpy_get_subscriptions_info_by_topic,
}


def _endpoints(node: Node, role: Role, topic: str, dds_names: bool) -> list[Endpoint]:
    # Not by the methods of rclpy's Node, which refuse names that ROS does not allow.
    with node.handle:
        if topic.isascii():
            with suppress(UnicodeDecodeError):
                return [
                    Endpoint(
                        each["node_name"],
                        each["node_namespace"],
                        each["topic_type"],
                        bytes(each["endpoint_gid"]),
                        QoSProfile(**each["qos_profile"]),
                    )
                    for each in _OF_RCLPY[role](node.handle, topic, dds_names)
                ]
        name = topic.encode(errors="surrogateescape")
        return rcl_graph.endpoints(node.handle.pointer, role, name, dds_names=dds_names)


LOOK_NODE = "_robotctl_look_"
"""Prefix of the node names of `robotctl topic|node|service`, which ROS tools hide."""

TOOL_NODES = (LOOK_NODE, "_ros2cli_")
"""Prefixes of the node names of commands that read topics and drive nothing."""

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""rmw's name for the node of an endpoint while that node is not discovered."""

PROCESS_BYTES = 12
"""Length of the gid prefix of a process (DDSI-RTPS 2.5, 8.2.4.1, GuidPrefix_t)."""

_OF_EVERY_NODE = "/parameter_events"
"""A topic that each node publishes from its creation on."""


def gid_of(publisher: Publisher) -> bytes:
    """Return the gid of this publisher's messages.

    Raises:
        RclCallFailed: The middleware does not report the gid.
    """
    gid = Gid()
    with publisher.handle:
        handle = function("rcl_publisher_get_rmw_handle", ctypes.c_void_p)
        rmw_publisher = handle(ctypes.c_void_p(publisher.handle.pointer))
        checked("rmw_get_gid_for_publisher", ctypes.c_void_p(rmw_publisher), ctypes.byref(gid))
    return bytes(gid.data)


def publisher_names(node: Node, topic: str) -> dict[bytes, str]:
    """Map the gid of each publisher of `topic` to its node's full name, "" if unknown."""
    return {each.gid: full_name(each) for each in publishers(node, topic)}


def node_of(node: Node, topic: str, gid: bytes) -> str:
    """Return the full name of the node that publishes `topic` with this `gid`, "" if unknown."""
    name = publisher_names(node, topic).get(gid, "")
    if name:
        return name
    # A message may arrive before its publisher is discovered: then the process's only node is it.
    of_process = {
        name
        for other, name in publisher_names(node, _OF_EVERY_NODE).items()
        if name and other[:PROCESS_BYTES] == gid[:PROCESS_BYTES]
    }
    return of_process.pop() if len(of_process) == 1 else ""


def full_name(endpoint: Endpoint) -> str:
    """Return the printable full name of an endpoint's node, "" if it is not discovered yet."""
    if endpoint.node_name == UNKNOWN_NODE:
        return ""
    return printable(f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}")


def shown_name(endpoint: Endpoint) -> str:
    """Return the full name of an endpoint's node, shortened, or a phrase if it is unknown."""
    return short_name(full_name(endpoint)) or "a node whose name is not known yet"


MAX_NAMES = 5000
"""Limit on the topics, services and nodes, of which other processes may create any number."""

_REQUEST_TOPIC = re.compile(r"rq(/.+)Request")
_REQUEST_TYPE = re.compile(r"(\w+)::srv::dds_::(\w+)_Request_|(\w+)::action::dds_::(\w+)_Request_")


def overview(node: Node) -> dict[str, Any]:
    """Return the names of all topics and services with their types, and the names of all nodes.

    Temporary nodes of robotctl's own commands are not listed. `left_out` counts the names that
    exceed MAX_NAMES.
    """
    found: dict[str, list[Any]] = {
        "topics": _typed(topics(node)),
        "services": _typed(services(node)),
        "nodes": sorted(name for name in node_names(node) if f"/{LOOK_NODE}" not in name),
    }
    return {
        **{kind: names[:MAX_NAMES] for kind, names in found.items()},
        "left_out": sum(max(len(names) - MAX_NAMES, 0) for names in found.values()),
    }


def topic_facts(node: Node, topic: str) -> dict[str, Any]:
    """Return name, types, publishers and subscriptions of the topic with the full name `topic`."""
    names = topic.encode(errors="surrogateescape").decode(errors="backslashreplace")
    writers = publishers(node, topic)[:MAX_NAMES]
    readers = subscriptions(node, topic)[:MAX_NAMES]
    return {
        "name": names,
        "types": sorted({each.topic_type for each in (*writers, *readers)}),
        "publishers": list(map(_endpoint, writers)),
        "subscriptions": list(map(_endpoint, readers)),
    }


def node_facts(node: Node, name: str) -> dict[str, Any] | None:
    """Return topics and services of the node with the full name `name`, None if it is unknown."""
    namespace, _, base = name.rpartition("/")
    try:
        with node.handle:
            lists = {
                key: _typed(dict(list_of(node.handle, *extra, base, namespace or "/")))
                for key, (list_of, extra) in _LISTS.items()
            }
    except (_rclpy.NodeNameNonExistentError, TypeError, UnicodeDecodeError):  # not UTF-8
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
    """Return service name -> types for each discovered service."""
    found: dict[str, set[str]] = {}
    for topic, types in topics(node, dds_names=True).items():
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
