"""Names and endpoints of the graph as bytes, because rclpy fails on names that are not UTF-8."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from enum import Enum
from functools import cache
from typing import Any, NamedTuple

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from robotctl.kernel.constants import NS_PER_S
from robotctl.ros.executor import RclCallFailed, rcutils

GID_BYTES = 16
"""RMW_GID_STORAGE_SIZE."""


class StringArray(ctypes.Structure):
    """The C structure `rcutils_string_array_t`."""

    _fields_ = (
        ("size", ctypes.c_size_t),
        ("data", ctypes.POINTER(ctypes.c_char_p)),
        ("allocator", rcutils.Allocator),
    )


class NamesAndTypes(ctypes.Structure):
    """The C structure `rmw_names_and_types_t`."""

    _fields_ = (("names", StringArray), ("types", ctypes.POINTER(StringArray)))


class Time(ctypes.Structure):
    """The C structure `rmw_time_t`."""

    _fields_ = (("sec", ctypes.c_uint64), ("nsec", ctypes.c_uint64))


class Qos(ctypes.Structure):
    """The C structure `rmw_qos_profile_t`."""

    _fields_ = (
        ("history", ctypes.c_int),
        ("depth", ctypes.c_size_t),
        ("reliability", ctypes.c_int),
        ("durability", ctypes.c_int),
        ("deadline", Time),
        ("lifespan", Time),
        ("liveliness", ctypes.c_int),
        ("liveliness_lease_duration", Time),
        ("avoid_ros_namespace_conventions", ctypes.c_bool),
    )


class EndpointInfo(ctypes.Structure):
    """The C structure `rmw_topic_endpoint_info_t`."""

    _fields_ = (
        ("node_name", ctypes.c_char_p),
        ("node_namespace", ctypes.c_char_p),
        ("topic_type", ctypes.c_char_p),
        ("type_hash", ctypes.c_uint8 * 33),
        ("endpoint_type", ctypes.c_int),
        ("gid", ctypes.c_uint8 * GID_BYTES),
        ("qos", Qos),
    )


class EndpointInfos(ctypes.Structure):
    """The C structure `rmw_topic_endpoint_info_array_t`."""

    _fields_ = (("size", ctypes.c_size_t), ("array", ctypes.POINTER(EndpointInfo)))


class SubscriptionOptions(ctypes.Structure):
    """The C structure `rmw_subscription_options_t`."""

    _fields_ = (
        ("payload", ctypes.c_void_p),
        ("ignore_local_publications", ctypes.c_bool),
        ("require_unique_network_flow_endpoints", ctypes.c_int),
        ("content_filter_options", ctypes.c_void_p),
    )


class PublisherOptions(ctypes.Structure):
    """The C structure `rmw_publisher_options_t`."""

    _fields_ = (
        ("payload", ctypes.c_void_p),
        ("require_unique_network_flow_endpoints", ctypes.c_int),
    )


class Gid(ctypes.Structure):
    """The C structure `rmw_gid_t`."""

    _fields_ = (("implementation", ctypes.c_char_p), ("data", ctypes.c_ubyte * GID_BYTES))


class Role(Enum):
    """The kind of an endpoint. The value is rcl's function that lists such endpoints."""

    PUBLISHER = "rcl_get_publishers_info_by_topic"
    SUBSCRIPTION = "rcl_get_subscriptions_info_by_topic"


class Endpoint(NamedTuple):
    """A publisher or subscription of any process. Bytes that are not UTF-8 are escaped."""

    node_name: str
    node_namespace: str
    topic_type: str
    gid: bytes
    qos_profile: QoSProfile


def escaped(text: bytes) -> str:
    """Return the text with backslash escapes for bytes that are not UTF-8."""
    return text.decode(errors="backslashreplace")


@cache
def function(name: str, restype: Any = ctypes.c_int) -> Any:
    """Return a C function of rcl, or of a library that rcl loads. Calls keep the GIL."""
    found = ctypes.PyDLL("librcl.so")[name]
    found.restype = restype
    return found


def checked(name: str, *arguments: Any) -> None:
    """Call a C function that returns 0 for success.

    Raises:
        RclCallFailed: The function returned another code.
    """
    code = function(name)(*arguments)
    if code:
        raise RclCallFailed(f"{name} failed with {code}: {rcutils.take_error_text()}")


def topic_names_and_types(node: int, *, dds_names: bool) -> list[tuple[bytes, list[bytes]]]:
    """Return the topics that the rcl_node_t at `node` has discovered, each with its types.

    Names are those of ROS or, with `dds_names`, of DDS.

    Raises:
        RclCallFailed: rcl could not list them.
    """
    found, allocator = NamesAndTypes(), rcutils.default_allocator()
    checked(
        "rcl_get_topic_names_and_types",
        ctypes.c_void_p(node),
        ctypes.byref(allocator),
        ctypes.c_bool(dds_names),
        ctypes.byref(found),
    )
    try:
        return [
            (name, list(_strings(found.types[index])))
            for index, name in enumerate(_strings(found.names))
        ]
    finally:
        function("rmw_names_and_types_fini")(ctypes.byref(found))


def node_names(node: int) -> list[tuple[bytes, bytes]]:
    """Return name and namespace of each node that the rcl_node_t at `node` has discovered.

    Raises:
        RclCallFailed: rcl could not list them.
    """
    names, namespaces = StringArray(), StringArray()
    allocator, both = rcutils.default_allocator(), (ctypes.byref(names), ctypes.byref(namespaces))
    checked("rcl_get_node_names", ctypes.c_void_p(node), allocator, *both)
    try:
        return list(zip(_strings(names), _strings(namespaces), strict=True))
    finally:
        for array in both:
            function("rcutils_string_array_fini")(array)


def endpoints(node: int, role: Role, topic: bytes, *, dds_names: bool) -> list[Endpoint]:
    """Return the endpoints of `topic` with the `role`.

    Raises:
        RclCallFailed: rcl could not list them.
    """
    found, allocator = EndpointInfos(), rcutils.default_allocator()
    checked(
        role.value,
        ctypes.c_void_p(node),
        ctypes.byref(allocator),
        ctypes.c_char_p(topic),
        ctypes.c_bool(dds_names),
        ctypes.byref(found),
    )
    try:
        return [_endpoint(found.array[index]) for index in range(found.size)]
    finally:
        fini = function("rmw_topic_endpoint_info_array_fini")
        fini(ctypes.byref(found), ctypes.byref(allocator))


def _strings(array: StringArray) -> Iterator[bytes]:
    return (array.data[index] for index in range(array.size))


def _endpoint(info: EndpointInfo) -> Endpoint:
    qos = info.qos
    return Endpoint(
        escaped(info.node_name),
        escaped(info.node_namespace),
        escaped(info.topic_type),
        bytes(info.gid),
        QoSProfile(
            history=HistoryPolicy(qos.history),
            depth=qos.depth,
            reliability=ReliabilityPolicy(qos.reliability),
            durability=DurabilityPolicy(qos.durability),
            deadline=_duration(qos.deadline),
            lifespan=_duration(qos.lifespan),
            liveliness=LivelinessPolicy(qos.liveliness),
            liveliness_lease_duration=_duration(qos.liveliness_lease_duration),
        ),
    )


def _duration(time: Time) -> Duration:
    nanoseconds = time.sec * NS_PER_S + time.nsec
    return Duration(nanoseconds=min(nanoseconds, 2**63 - 1))
