"""Waiting until all processes in a ROS domain are discovered."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Final

from rclpy.node import Node

from robotctl.domains import is_on_this_machine_only, participants_here
from robotctl.ros.graph import endpoints

_DISCOVERY_TOPIC: Final = "ros_discovery_info"
"""The DDS topic on which each ROS process announces which endpoints belong to which node."""

_UNNAMED: Final = "_NODE_NAME_UNKNOWN_"
"""The node name of an endpoint that its process has not announced there yet."""

_PROCESS_BYTES: Final = 12
"""Length of the gid prefix that all endpoints of a process share (DDSI-RTPS 2.5, 8.2.4.1,
GuidPrefix_t)."""

_POLL_S: Final = 0.01


class Discovery:
    """The other endpoints that a node has discovered, and since when none was added or removed."""

    def __init__(self, node: Node, domain_id: int) -> None:
        self._node = node
        self._domain_id = domain_id
        self._others: frozenset[tuple[str, str, bytes]] = frozenset()
        self._since_s = time.monotonic()

    def wait(self, quiet_s: float, until_s: float, stopped: threading.Event) -> None:
        """Wait until all processes are discovered and nothing changed for `quiet_s` seconds.

        The wait ends at `until_s` (`time.monotonic`) at the latest, or when `stopped` is set.

        Fast DDS announces a process every 3 s by default, and about half of the first
        announcements get lost. So the processes on this machine are counted by their ports; where
        processes may be on other machines, which cannot be counted, the wait lasts until
        `until_s`. A process may announce its last endpoint after it has announced its nodes:
        `quiet_s` waits for that.
        """
        while time.monotonic() < until_s and not stopped.is_set():
            if self.is_complete(quiet_s):
                return
            stopped.wait(_POLL_S)

    def is_alone(self) -> bool:
        """Return whether there is no other process in the domain: nothing is to be discovered.

        False where processes may be on other machines.
        """
        return is_on_this_machine_only() and participants_here(self._domain_id) == 1

    def is_complete(self, quiet_s: float) -> bool:
        """Look at the graph; return whether all processes are discovered and quiet, as in `wait`.

        False where processes may be on other machines.
        """
        known = frozenset(_discovered(self._node))
        others = frozenset(each for each in known if each[1] != self._node.get_name())
        now_s = time.monotonic()
        if others != self._others:
            self._others, self._since_s = others, now_s
        if now_s - self._since_s <= quiet_s or not is_on_this_machine_only():
            return False
        here = participants_here(self._domain_id)
        return here is not None and _count_complete(known) >= here


def _discovered(node: Node) -> Iterator[tuple[str, str, bytes]]:
    """Yield every discovered endpoint: its topic, its node's name, and its gid."""
    for topic in endpoints.topics(node, dds_names=True):
        for found in (endpoints.publishers, endpoints.subscriptions):
            for each in found(node, topic, dds_names=True):
                yield topic, each.node_name, each.gid


def _count_complete(known: frozenset[tuple[str, str, bytes]]) -> int:
    """Count the processes, this one included, whose known endpoints all have a node name."""
    named: set[bytes] = set()
    unnamed: set[bytes] = set()
    for topic, node_name, gid in known:
        if topic != _DISCOVERY_TOPIC:  # its endpoints belong to no node
            (unnamed if node_name == _UNNAMED else named).add(gid[:_PROCESS_BYTES])
    return len(named - unnamed)
