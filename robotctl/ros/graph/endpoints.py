"""The topics, publishers and subscriptions of the domain; their names may hold any bytes."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any, NamedTuple

from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.utilities import get_rmw_implementation_identifier
from rclpy.validate_full_topic_name import validate_full_topic_name

from robotctl.base.text import printable
from robotctl.ros.graph import rcl_graph
from robotctl.ros.graph.rcl_graph import Gid, Role


class Endpoint(NamedTuple):
    """A publisher or subscription of any process; in names, bytes other than UTF-8 are escaped."""

    node_name: str
    node_namespace: str
    topic_type: str
    gid: bytes
    qos_profile: QoSProfile


def topics(node: Node, *, dds_names: bool = False) -> dict[str, list[str]]:
    """Return full topic name -> types; with `dds_names`, the names and types of DDS, not of ROS.

    A byte that is not UTF-8 becomes a surrogate escape in a name, as in file names, and a backslash
    escape in a type.
    """
    try:
        return dict(node.get_topic_names_and_types(dds_names))
    except UnicodeDecodeError:
        with node.handle:
            found = rcl_graph.topic_names_and_types(node.handle.pointer, dds_names=dds_names)
    return {
        name.decode(errors="surrogateescape"): [_escaped(each) for each in types]
        for name, types in found
    }


def publishers(node: Node, topic: str, *, dds_names: bool = False) -> list[Endpoint]:
    """Return the publishers of a topic; `topic` is a key of the dict that `topics` returns."""
    return _endpoints(node, Role.PUBLISHER, topic, dds_names)


def subscriptions(node: Node, topic: str, *, dds_names: bool = False) -> list[Endpoint]:
    """Return the subscriptions to a topic; `topic` is as in `publishers`."""
    return _endpoints(node, Role.SUBSCRIPTION, topic, dds_names)


def publisher_count(node: Node, topic: str) -> int:
    """Return how many publishers a topic has; `topic` is its full name.

    rclpy's `Node.count_publishers` would expand and validate the name each time.
    """
    with node.handle:
        count: int = node.handle.get_count_publishers(topic)
        return count


def subscription_count(node: Node, topic: str) -> int:
    """Return how many subscriptions a topic has; `topic` is its full name."""
    with node.handle:
        count: int = node.handle.get_count_subscribers(topic)
        return count


def node_names(node: Node) -> list[str]:
    """Return the full name of each discovered node; a name that two nodes share is listed twice."""
    with node.handle:
        found = rcl_graph.node_names(node.handle.pointer)
    return [f"{_escaped(space).rstrip('/')}/{_escaped(name)}" for name, space in found]


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
            try:
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
            except UnicodeDecodeError:
                pass
        name = topic.encode(errors="surrogateescape")
        found = rcl_graph.endpoints(node.handle.pointer, role, name, dds_names=dds_names)
    return [
        Endpoint(
            _escaped(each.node_name),
            _escaped(each.node_namespace),
            _escaped(each.topic_type),
            each.gid,
            each.qos_profile,
        )
        for each in found
    ]


def _escaped(text: bytes) -> str:
    return text.decode(errors="backslashreplace")


LOOK_NODE = "_robotctl_look_"
"""Prefix of the names of nodes of `robotctl topic|node|service`; ROS tools hide such nodes."""

TOOL_NODES = (LOOK_NODE, "_ros2cli_")
"""Prefixes of the node names of commands that read topics and drive nothing."""

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""The node name that rmw reports for an endpoint while the endpoint's node is not discovered."""

PROCESS_BYTES = 12
"""Length of the gid prefix that all endpoints of a process share (DDSI-RTPS 2.5, 8.2.4.1,
GuidPrefix_t)."""

_OF_EVERY_NODE = "/parameter_events"
"""A topic that each node publishes from its creation on."""


def gid_of(publisher: Publisher) -> bytes:
    """Return the gid that messages of this publisher carry.

    Raises:
        RuntimeError: The middleware does not report the gid.
    """
    gid = Gid()
    with publisher.handle:
        rmw_publisher = _rmw_handle_getter()(publisher.handle.pointer)
        code = _gid_getter()(rmw_publisher, ctypes.byref(gid))
    if code:
        raise RuntimeError(f"rmw_get_gid_for_publisher failed with {code}")
    return bytes(gid.data)


def publisher_names(node: Node, topic: str) -> dict[bytes, str]:
    """Return gid -> full name of the node, "" if unknown, for each publisher of a topic."""
    return {each.gid: full_name(each) for each in publishers(node, topic)}


def node_of(node: Node, topic: str, gid: bytes) -> str:
    """Return the full name of the node whose publisher of a topic has this gid, "" if unknown.

    A message may arrive before its publisher is discovered, but by then the publisher's process is.
    So if the publisher is unknown, but its process has only one node, return this node's name.
    """
    name = publisher_names(node, topic).get(gid, "")
    if name:
        return name
    of_process = {
        name
        for other, name in publisher_names(node, _OF_EVERY_NODE).items()
        if name and other[:PROCESS_BYTES] == gid[:PROCESS_BYTES]
    }
    return of_process.pop() if len(of_process) == 1 else ""


def full_name(endpoint: Endpoint) -> str:
    """Return the full name of an endpoint's node, "" if the node is not discovered yet.

    Characters that are not printable are escaped.
    """
    if endpoint.node_name == UNKNOWN_NODE:
        return ""
    return printable(f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}")


@cache
def _rmw_handle_getter() -> Any:
    function = ctypes.CDLL("librcl.so").rcl_publisher_get_rmw_handle
    function.argtypes = [ctypes.c_void_p]
    function.restype = ctypes.c_void_p
    return function


@cache
def _gid_getter() -> Any:
    # The wheels have no librmw_implementation.so, which would choose the middleware.
    library = ctypes.CDLL(f"lib{get_rmw_implementation_identifier()}.so")
    function = library.rmw_get_gid_for_publisher
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function
