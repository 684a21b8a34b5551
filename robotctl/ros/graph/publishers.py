"""Who publishes a topic, by the identity that each of its messages carries."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.utilities import get_rmw_implementation_identifier

from robotctl.printable import printable
from robotctl.ros.graph import endpoints

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""What rmw says of a publisher that it discovered before its node."""

GID_BYTES = 16
"""RMW_GID_STORAGE_SIZE of Jazzy; the same bytes as in the info of each message."""


class _Gid(ctypes.Structure):
    """rmw_gid_t"""

    _fields_ = (("implementation", ctypes.c_char_p), ("data", ctypes.c_ubyte * GID_BYTES))


def gid_of(publisher: Publisher) -> bytes:
    """Return the identity that messages of this publisher carry.

    Raises RuntimeError where the middleware does not tell it.
    """
    gid = _Gid()
    with publisher.handle:
        rmw_publisher = _rmw_handle_getter()(publisher.handle.pointer)
        code = _gid_getter()(rmw_publisher, ctypes.byref(gid))
    if code:
        raise RuntimeError(f"rmw_get_gid_for_publisher failed with {code}")
    return bytes(gid.data)


def publisher_names(node: Node, topic: str) -> dict[bytes, str]:
    """Return the full name of the node of each publisher, by identity; "" where unknown."""
    return {each.gid: full_name(each) for each in endpoints.publishers(node, topic)}


def full_name(endpoint: endpoints.Endpoint) -> str:
    """Return the full name of the node of an endpoint, "" where it is not discovered yet.

    What is not printable in it is escaped.
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
