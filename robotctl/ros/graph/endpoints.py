"""The topics, publishers and subscriptions of the domain; their names may hold any bytes."""

from __future__ import annotations

from typing import NamedTuple

from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.validate_full_topic_name import validate_full_topic_name

from robotctl.ros.graph import rcl_graph
from robotctl.ros.graph.rcl_graph import Role


class Endpoint(NamedTuple):
    """A publisher or subscription of any process; bytes that are not UTF-8 become `\\xff`."""

    node_name: str
    node_namespace: str
    topic_type: str
    gid: bytes
    qos_profile: QoSProfile


def topics(node: Node, *, dds_names: bool = False) -> dict[str, list[str]]:
    """Return full topic name -> types; names are those of ROS or, with `dds_names`, of DDS.

    Bytes that are not UTF-8 are surrogate escapes in names, as in file names, and backslash
    escapes in types.
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
    """Return the publishers of a topic, by a name that `topics` returned."""
    return _endpoints(node, Role.PUBLISHER, topic, dds_names)


def subscriptions(node: Node, topic: str, *, dds_names: bool = False) -> list[Endpoint]:
    """Return the subscriptions to a topic, by a name that `topics` returned."""
    return _endpoints(node, Role.SUBSCRIPTION, topic, dds_names)


def publisher_count(node: Node, topic: str) -> int:
    """Return how many publishers a topic has, by a name that `topics` returned.

    The method of the node would expand and validate the name each time.
    """
    with node.handle:
        count: int = node.handle.get_count_publishers(topic)
        return count


def subscription_count(node: Node, topic: str) -> int:
    """Return how many subscriptions a topic has, by a name that `topics` returned."""
    with node.handle:
        count: int = node.handle.get_count_subscribers(topic)
        return count


def node_names(node: Node) -> list[str]:
    """Return the full name of each discovered node; one of two processes stands there twice."""
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
    # The methods of the node would refuse names that ROS does not allow.
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
