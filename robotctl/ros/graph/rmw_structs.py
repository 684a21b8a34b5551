"""The C structures with which rmw describes the graph, as of ROS 2 Jazzy."""

from __future__ import annotations

import ctypes

from robotctl.ros.executor import rcutils

GID_BYTES = 16
"""RMW_GID_STORAGE_SIZE; each message's info holds the same bytes."""


class StringArray(ctypes.Structure):
    """rcutils_string_array_t"""

    _fields_ = (
        ("size", ctypes.c_size_t),
        ("data", ctypes.POINTER(ctypes.c_char_p)),
        ("allocator", rcutils.Allocator),
    )


class NamesAndTypes(ctypes.Structure):
    """rmw_names_and_types_t"""

    _fields_ = (("names", StringArray), ("types", ctypes.POINTER(StringArray)))


class Time(ctypes.Structure):
    """rmw_time_t"""

    _fields_ = (("sec", ctypes.c_uint64), ("nsec", ctypes.c_uint64))


class Qos(ctypes.Structure):
    """rmw_qos_profile_t"""

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
    """rmw_topic_endpoint_info_t"""

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
    """rmw_topic_endpoint_info_array_t"""

    _fields_ = (("size", ctypes.c_size_t), ("array", ctypes.POINTER(EndpointInfo)))


class SubscriptionOptions(ctypes.Structure):
    """rmw_subscription_options_t"""

    _fields_ = (
        ("payload", ctypes.c_void_p),
        ("ignore_local_publications", ctypes.c_bool),
        ("require_unique_network_flow_endpoints", ctypes.c_int),
        ("content_filter_options", ctypes.c_void_p),
    )


class PublisherOptions(ctypes.Structure):
    """rmw_publisher_options_t"""

    _fields_ = (
        ("payload", ctypes.c_void_p),
        ("require_unique_network_flow_endpoints", ctypes.c_int),
    )


class Gid(ctypes.Structure):
    """rmw_gid_t"""

    _fields_ = (("implementation", ctypes.c_char_p), ("data", ctypes.c_ubyte * GID_BYTES))
