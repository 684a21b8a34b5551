"""What the methods about the ROS graph answer, as it stands in JSON."""

from __future__ import annotations

from typing import TypedDict


class NameAndTypes(TypedDict):
    """A topic or a service: its full name, and its types, which should be one."""

    name: str
    types: list[str]


class Graph(TypedDict):
    """The names that the daemon sees on ROS; `left_out` says how many more there are."""

    topics: list[NameAndTypes]
    services: list[NameAndTypes]
    nodes: list[str]
    left_out: int


class GraphEndpoint(TypedDict):
    """A publisher or a subscription; `node` is "" while it is unknown.

    `qos` has reliability, durability, history and depth; "unknown" is what DDS does not tell.
    """

    node: str
    type: str
    gid: str
    qos: dict[str, str | int]


class GraphTopic(TypedDict):
    """A topic with all that publish it or subscribe to it; both are empty for an unknown one."""

    name: str
    types: list[str]
    publishers: list[GraphEndpoint]
    subscriptions: list[GraphEndpoint]


class GraphNode(TypedDict):
    """What a node publishes, subscribes to, serves and calls."""

    name: str
    publishers: list[NameAndTypes]
    subscriptions: list[NameAndTypes]
    servers: list[NameAndTypes]
    clients: list[NameAndTypes]
