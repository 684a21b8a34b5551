"""Reports the graph's topics, and subscribes to a topic only while its messages are wanted."""

from __future__ import annotations

from typing import Final, Protocol

from rclpy.node import Node
from rclpy.qos import QoSProfile

from robotctl.base.text import short_name
from robotctl.messages.installed import installed_type
from robotctl.ros.executor import ViewSink, announcements
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.discovery import GraphChanges
from robotctl.ros.tap.subscription import TappedSubscription, TypeLoader, offered_types

LATENCY_S: Final = 0.01
"""How long messages are collected. One wake-up of the loop costs as much as ten messages."""

POLL_S: Final = 0.1
"""The time between two looks at the graph while it changes."""

CALM_S: Final = 1.0
"""The time between two looks at the graph without an announced change. rcl announces no new QoS."""

MAX_TOPICS: Final = 5_000
"""Limit on the reported topics, of which other processes may create any number."""


class TopicWatcher(Protocol):
    """Receives the findings of `OnDemandTap` about the topics of the graph."""

    def appeared(self, topic: str, type_name: str, definition: str) -> None:
        """Add a topic with a publisher. `definition` is the ros2msg text of its type."""

    def vanished(self, topic: str) -> None:
        """Remove a topic that has no publisher of its type any more."""

    def unusable(self, topic: str, problem: str) -> None:
        """Report why `topic` cannot be shown; a `problem` of "" means that it can be again."""


class OnDemandTap:
    """Reports the topics of the graph, and subscribes on request. For the loop's thread only."""

    def __init__(self, node: Node, watcher: TopicWatcher) -> None:
        self._node = node
        self._watcher = watcher
        self._types = TypeLoader()
        self._known: dict[str, str] = {}
        """Reported topic -> its type."""

        self._problems: dict[str, str] = {}
        self._sinks: dict[str, ViewSink] = {}
        self._tapped: dict[str, TappedSubscription] = {}

    async def run(self) -> None:
        """Watch the graph until cancelled."""
        with GraphChanges(self._node) as changes:
            while True:
                is_loading = self._look()
                await self._types.pause(POLL_S)
                await changes.wait(0.0 if is_loading else CALM_S)

    def want(self, topic: str, sink: ViewSink) -> None:
        """Subscribe to a reported topic, and pass its messages to `sink`, latched ones first.

        If the topic is subscribed already, subscribe again for its latched messages, if it has any.
        """
        if topic in self._tapped and not self._tapped[topic].is_latched:
            return
        self.unwant(topic)
        self._sinks[topic] = sink
        self._tap(topic)

    def unwant(self, topic: str) -> None:
        """End the subscription to a topic."""
        self._sinks.pop(topic, None)
        if topic in self._tapped:
            self._tapped.pop(topic).close()

    def _look(self) -> bool:
        """Report topics that appeared or vanished. Return whether a type is still loading."""
        present = list(endpoints.topics(self._node))[:MAX_TOPICS]
        is_loading = False
        for topic in present:
            if not topic.startswith(announcements.TOPIC_PREFIX):
                is_loading |= self._look_at(topic)
        for topic in (self._known.keys() | self._problems.keys()) - set(present):
            self._forget(topic)
        return is_loading

    def _look_at(self, topic: str) -> bool:
        """Report the changes of a topic. Return whether its type is still loading."""
        if not endpoints.is_topic_name(topic) or not endpoints.publisher_count(self._node, topic):
            self._forget(topic)
            return False
        if topic in self._known and topic not in self._sinks:
            return False
        offered = offered_types(self._node, topic)
        if topic in self._known:
            if offered.get(self._known[topic]):
                self._tap(topic, offered)
                return False
            self._forget(topic)
        is_loading = False
        problem = ""
        for type_name in offered:
            unusable = self._types.problem(type_name)
            if unusable == "":
                self._tell(topic, "")
                self._known[topic] = type_name
                self._watcher.appeared(topic, type_name, installed_type(type_name).text)
                return False
            is_loading |= unusable is None
            problem = f"its type {short_name(type_name)} {unusable}"
        if not is_loading:
            self._tell(topic, f"{short_name(topic)} is not shown: {problem}" if problem else "")
        return is_loading

    def _forget(self, topic: str) -> None:
        self._tell(topic, "")
        if self._known.pop(topic, None) is not None:
            self.unwant(topic)
            self._watcher.vanished(topic)

    def _tell(self, topic: str, problem: str) -> None:
        if self._problems.get(topic, "") == problem:
            return
        if problem:
            self._problems[topic] = problem
        else:
            del self._problems[topic]
        self._watcher.unusable(topic, problem)

    def _tap(self, topic: str, offered: dict[str, list[QoSProfile]] | None = None) -> None:
        """Subscribe to a wanted topic, or adapt the subscription to the QoS of the publishers."""
        type_name = self._known[topic]
        profiles = (offered or offered_types(self._node, topic)).get(type_name, [])
        try:
            if topic in self._tapped:
                self._tapped[topic].adapt(profiles)
            else:
                self._tapped[topic] = TappedSubscription(
                    self._node, topic, type_name, self._sinks[topic], profiles, LATENCY_S
                )
        except Exception as error:  # noqa: BLE001 - a foreign topic must not end the others
            reason = short_name(f"{type(error).__name__}: {error}")
            self._tell(topic, f"{topic} is not shown: it cannot be subscribed to ({reason})")
        else:
            self._tell(topic, "")
