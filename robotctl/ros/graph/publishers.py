"""The gid of a publisher, which each of its messages carries, and the node it belongs to."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.utilities import get_rmw_implementation_identifier

from robotctl.printable import printable
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.rmw_structs import Gid

LOOK_NODE = "_robotctl_look_"
"""How the node of a `robotctl topic|node|service` command begins; ROS tools do not list it."""

TOOL_NODES = (LOOK_NODE, "_ros2cli_")
"""How the nodes of commands begin that look at topics and drive nothing."""

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""The node name that rmw reports for a publisher discovered before its node."""

PROCESS_BYTES = 12
"""Length of the gid prefix that all endpoints of a process share (DDSI-RTPS 2.5, 8.2.4.1,
GuidPrefix_t)."""

_OF_EVERY_NODE = "/parameter_events"
"""A topic on which each node publishes from its beginning."""


def gid_of(publisher: Publisher) -> bytes:
    """Return the gid that messages of this publisher carry.

    Raises:
        RuntimeError: The middleware does not report it.
    """
    gid = Gid()
    with publisher.handle:
        rmw_publisher = _rmw_handle_getter()(publisher.handle.pointer)
        code = _gid_getter()(rmw_publisher, ctypes.byref(gid))
    if code:
        raise RuntimeError(f"rmw_get_gid_for_publisher failed with {code}")
    return bytes(gid.data)


def publisher_names(node: Node, topic: str) -> dict[bytes, str]:
    """Return the node of each publisher of a topic as gid -> full name, "" where unknown."""
    return {each.gid: full_name(each) for each in endpoints.publishers(node, topic)}


def node_of(node: Node, topic: str, gid: bytes) -> str:
    """Return the full name of the node with this publisher of a topic, "" where unknown.

    A message may come before its publisher is announced. Its process is known by then: if that has
    one node, the publisher is that node's.
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


def full_name(endpoint: endpoints.Endpoint) -> str:
    """Return the full name of an endpoint's node, "" where the node is not discovered yet.

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
