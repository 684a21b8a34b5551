"""Publishes the velocity command for a gate, where each role is a process of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from robotctl.kernel.params import OWNER_SUFFIX
from robotctl.printable import short_name
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.publishers import full_name, publisher_names
from robotctl.ros.messages.command_type import CommandType
from robotctl.ros.nodes.velocity_publisher import (
    MAX_NAMED,
    OWNER_NODE,
    VelocityPublisher,
    is_monitor,
    named_nodes,
)
from robotctl.ros.session import Session

PARTICIPANT = slice(12)
"""The part of a gid that names its DDS participant (DDSI-RTPS 2.5, 9.3.1: the GUID prefix)."""

REFRESH_S = 0.05
"""The shortest time between two looks for the gate of a command that no known gate has sent."""


class OwnerVelocity(VelocityPublisher):
    """Node `mode_owner`: its commands reach the robot through the gate, `velocity_publisher`.

    A gate is a node that subscribes to our commands and publishes the robot's command topic. It is
    known by the gid of that publisher, so gates that come and go do not hide another publisher.
    """

    def __init__(
        self, session: Session, topic: str, command: CommandType, is_silent: Callable[[], bool]
    ) -> None:
        """Publish on `topic`, the robot's command topic with OWNER_SUFFIX."""
        super().__init__(session, topic, command, is_silent, OWNER_NODE)
        self.robot_topic = self.topic.removesuffix(OWNER_SUFFIX)
        """The full name of the topic that the gate publishes."""
        self._gates: frozenset[bytes] = frozenset()
        self._looked_s = 0.0

    def monitor(
        self, heard: Callable[[bytes], None], latency_s: float | None
    ) -> Callable[[], None]:
        """Call `heard(gid)` for each command for the gate, and for each one past it."""

        def heard_by_robot(gid: bytes) -> None:
            if not self._is_gate(gid):
                heard(gid)

        looks = (
            super().monitor(heard, latency_s),
            self._monitor(self.robot_topic, heard_by_robot, latency_s),
        )

        def look() -> None:
            for each in looks:
                each()

        return look

    def name_of(self, gid: bytes) -> str:
        """Return the name of the node whose commands carry this gid, "" where unknown."""
        return super().name_of(gid) or publisher_names(self._node, self.robot_topic).get(gid, "")

    def other_publishers(self) -> tuple[str, ...]:
        """Return the nodes that publish our commands or the robot's, the gates left out."""
        gates = self._find_gates()
        robots = endpoints.publishers(self._node, self.robot_topic)
        past = named_nodes(each for each in robots if each.gid not in gates)
        return (*super().other_publishers(), *past)

    def listeners(self) -> tuple[int, tuple[str, ...], str]:
        """Return how many gates and robots take commands, the other types, and ours."""
        robots, types = self._robots()
        return len(self._find_gates()) + robots, types, self._type_name

    def count_listeners(self) -> int:
        """Return how many subscriptions both topics have, recorders included."""
        return super().count_listeners() + int(self._node.count_subscribers(self.robot_topic))

    def gate_problem(self) -> str:
        """Return why commands do not reach a robot through one gate, "" where they do."""
        gates = self._find_gates()
        if not gates:
            return f"no gate passes commands on to {self.robot_topic}"
        if len(gates) > 1:
            return f"{len(gates)} gates publish {self.robot_topic}"
        if not self._takes_our_type(gates):
            return f"the gate does not take {self._type_name} yet"
        robots, types = self._robots()
        if robots:
            return ""
        takers = f"only {', '.join(types)}" if types else "nothing"
        return f"behind the gate {takers} takes {self.robot_topic}"

    def _robots(self) -> tuple[int, tuple[str, ...]]:
        """Return how many subscriptions take the gate's commands, and the other types."""
        types = [
            short_name(each.topic_type)
            for each in endpoints.subscriptions(self._node, self.robot_topic)
            if not is_monitor(each.node_name)
        ]
        others = sorted(set(types) - {self._type_name})
        return types.count(self._type_name), tuple(others[:MAX_NAMED])

    def _takes_our_type(self, gates: frozenset[bytes]) -> bool:
        """Return whether a gate takes our type and passes it on: it hears no other."""

        def of_our_type(found: Iterable[endpoints.Endpoint]) -> list[endpoints.Endpoint]:
            return [each for each in found if short_name(each.topic_type) == self._type_name]

        subscribed = of_our_type(endpoints.subscriptions(self._node, self.topic))
        takers = {_node_of(each) for each in subscribed}
        published = of_our_type(endpoints.publishers(self._node, self.robot_topic))
        return any(each.gid in gates and _node_of(each) in takers for each in published)

    def _is_gate(self, gid: bytes) -> bool:
        if gid in self._gates:
            return True
        if time.monotonic() - self._looked_s < REFRESH_S:
            return False
        return gid in self._find_gates()

    def _find_gates(self) -> frozenset[bytes]:
        """Look for the gates; return the gids of their publishers."""
        self._looked_s = time.monotonic()
        takers = {_node_of(each) for each in endpoints.subscriptions(self._node, self.topic)}
        self._gates = frozenset(
            each.gid
            for each in endpoints.publishers(self._node, self.robot_topic)
            if _node_of(each) in takers
        )
        return self._gates


def _node_of(endpoint: endpoints.Endpoint) -> tuple[bytes, str]:
    return endpoint.gid[PARTICIPANT], full_name(endpoint)
