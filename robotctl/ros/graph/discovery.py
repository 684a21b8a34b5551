"""Waiting until all processes in a ROS domain are discovered, and have discovered this one."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from rclpy.node import Node

from robotctl.domains import is_on_this_machine_only, participants_here
from robotctl.ros.graph import endpoints, introductions
from robotctl.ros.graph.introductions import (
    Introduction,
    IntroductionReader,
    IntroductionWriter,
)
from robotctl.ros.graph.publishers import PROCESS_BYTES, gid_of

_POLL_S: Final = 0.005
_ACKNOWLEDGED_POLL_S: Final = 0.001

REPEAT_S: Final = 0.02
"""The time between two messages that others shall acknowledge; that takes them about 8 ms."""


class FoundEndpoint(NamedTuple):
    """A discovered endpoint."""

    gid: bytes
    introduces: bool
    """Whether its topic is that of the introductions: it need not belong to a node."""

    @property
    def process(self) -> bytes:
        """The part of the gid that all endpoints of a process share."""
        return self.gid[:PROCESS_BYTES]


class Discovery:
    """The other endpoints that a node has discovered, and since when none was added or removed.

    Close it before the node is destroyed.
    """

    def __init__(self, node: Node, domain_id: int) -> None:
        self._node = node
        self._domain_id = domain_id
        self._introductions = IntroductionReader(node)
        self._process = gid_of(next(node.publishers))[:PROCESS_BYTES]
        self._others: frozenset[FoundEndpoint] = frozenset()
        self._since_s = time.monotonic()

    def close(self) -> None:
        """Remove what it added to the graph."""
        self._introductions.close()

    def wait(self, quiet_s: float, until_s: float, stopped: threading.Event) -> None:
        """Wait until all processes are discovered and nothing changed for `quiet_s` seconds.

        The wait ends at `until_s` (`time.monotonic`) at the latest, or when `stopped` is set.

        Fast DDS announces a process every 3 s by default, and about half of the first
        announcements get lost. So the processes on this machine are counted by their ports; where
        processes may be on other machines, which cannot be counted, the wait lasts until
        `until_s`. A process that starts adds one endpoint after the other: `quiet_s` waits for
        that.
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
        if not is_on_this_machine_only():
            return False
        self._introductions.look()
        introduced, here = self._introductions.by_process, participants_here(self._domain_id)
        if here is None or len(introduced) < here:
            return False  # without a look at all endpoints, which takes 30 us for each
        known = frozenset(_discovered(self._node))
        others = frozenset(each for each in known if each.process != self._process)
        now_s = time.monotonic()
        if others != self._others:
            self._others, self._since_s = others, now_s
        return now_s - self._since_s >= quiet_s and count_complete(known, introduced) >= here

    def make_known(self, until_s: float, stopped: threading.Event) -> bool:
        """Wait until all discovered processes know all publishers of this one.

        Returns False where one has not said so at `until_s`, or when `stopped` is set.
        """
        writer = IntroductionWriter(self._node)
        try:
            repeat_s = 0.0
            while (now_s := time.monotonic()) < until_s and not stopped.is_set():
                self._introductions.look()
                ours = self._introductions.by_process.get(self._process)
                if ours is not None and now_s >= repeat_s:
                    writer.write(ours.data)
                    repeat_s = now_s + REPEAT_S
                if repeat_s and writer.is_acknowledged():
                    return True
                stopped.wait(_ACKNOWLEDGED_POLL_S)
            return False
        finally:
            writer.close()


def _discovered(node: Node) -> Iterator[FoundEndpoint]:
    for topic in endpoints.topics(node, dds_names=True):
        for find in (endpoints.publishers, endpoints.subscriptions):
            for each in find(node, topic, dds_names=True):
                yield FoundEndpoint(each.gid, topic == introductions.TOPIC)


def count_complete(known: Iterable[FoundEndpoint], introduced: Mapping[bytes, Introduction]) -> int:
    """Count the processes that have introduced themselves with exactly their known endpoints."""
    of_nodes: dict[bytes, set[bytes]] = {}
    all_gids: dict[bytes, set[bytes]] = {}
    for each in known:
        all_gids.setdefault(each.process, set()).add(each.gid)
        if not each.introduces:
            of_nodes.setdefault(each.process, set()).add(each.gid)
    return sum(
        of_nodes.get(process, set()) <= introduction.endpoints <= all_gids.get(process, set())
        for process, introduction in introduced.items()
    )
