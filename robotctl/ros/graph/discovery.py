"""Waiting until everybody in a ROS domain is discovered."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Final

from rclpy.node import Node

from robotctl.domains import is_on_this_machine_only, participants_here
from robotctl.ros.graph import endpoints

_DISCOVERY_TOPIC: Final = "ros_discovery_info"
"""By it every process of ROS says which endpoints each of its nodes has."""

_UNNAMED: Final = "_NODE_NAME_UNKNOWN_"
"""The node of an endpoint of which its process has said nothing yet."""

_PROCESS_BYTES: Final = 12
"""What all endpoints of a process begin with (DDSI-RTPS 2.5, 8.2.4.1, GuidPrefix_t)."""

_POLL_S: Final = 0.01


class Discovery:
    """What a node knows of the others in its domain, and since when that is all that is new."""

    def __init__(self, node: Node, domain_id: int) -> None:
        self._node = node
        self._domain_id = domain_id
        self._others: frozenset[tuple[str, str, bytes]] = frozenset()
        self._since_s = time.monotonic()

    def wait(self, quiet_s: float, until_s: float, stopped: threading.Event) -> None:
        """Return when everybody is heard and others were quiet for a while, or at a moment.

        Fast DDS announces a process every 3 s by default, and about half of the greetings before
        that get lost: how many there are is counted by their ports. All the time is taken where
        others may be on other machines, which nobody can count. Of what a process has, the last
        may come later than the process has said whose it is: hence the quiet.
        """
        while time.monotonic() < until_s and not stopped.is_set():
            known = frozenset(_known(self._node))
            others = frozenset(each for each in known if each[1] != self._node.get_name())
            now_s = time.monotonic()
            if others != self._others:
                self._others, self._since_s = others, now_s
            if now_s - self._since_s > quiet_s and is_on_this_machine_only():
                here = participants_here(self._domain_id)
                if here is not None and _heard(known) >= here:
                    return
            stopped.wait(_POLL_S)


def _known(node: Node) -> Iterator[tuple[str, str, bytes]]:
    """Every endpoint in the domain: its topic, its node's name, and its identity."""
    for topic in endpoints.topics(node, dds_names=True):
        for found in (endpoints.publishers, endpoints.subscriptions):
            for each in found(node, topic, dds_names=True):
                yield topic, each.node_name, each.gid


def _heard(known: frozenset[tuple[str, str, bytes]]) -> int:
    """How many processes have said whose each of their known endpoints is; we among them."""
    named: set[bytes] = set()
    unnamed: set[bytes] = set()
    for topic, node_name, gid in known:
        if topic != _DISCOVERY_TOPIC:  # its endpoints belong to no node
            (unnamed if node_name == _UNNAMED else named).add(gid[:_PROCESS_BYTES])
    return len(named - unnamed)
