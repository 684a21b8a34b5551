"""Subscribes to every topic of the graph, and passes its serialized messages to a sink."""

from __future__ import annotations

import asyncio
import logging
import resource
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice, product
from typing import Final

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.base.text import printable, short_name
from robotctl.messages.installed import installed_type
from robotctl.ros import qos
from robotctl.ros.executor import ViewSink, announcements
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.discovery import GraphChanges
from robotctl.ros.graph.endpoints import Endpoint, full_name
from robotctl.ros.message_types import OwnTopic
from robotctl.ros.session import Session
from robotctl.ros.tap.subscription import SLOW_LOAD_S, TappedSubscription, TypeLoader, offered_types

_log = logging.getLogger(__name__)

MAX_ENDPOINTS: Final = 20
"""Limit on the publishers and on the subscriptions of a topic with compared QoS."""

MAX_NAMED: Final = 20

MAX_SAID: Final = 1_000
"""Limit on the logged sentences, since other processes may create topics without end."""


class Sentences:
    """Keeps the sentence that describes each topic's problem, and logs each sentence once."""

    def __init__(self, most: int, more: str) -> None:
        """Limit `warnings` to `most` sentences and "N more topics" with the text `more`."""
        self.by_topic: dict[str, str] = {}
        self._most, self._more = most, more
        self._said: set[str] = set()
        self._logged = 0

    def note(self, topic: str, sentence: str) -> None:
        """Keep the sentence that describes a topic's problem, and log it if it is new."""
        self.by_topic[topic] = sentence
        self.say(sentence)

    def clear(self, topics: Iterable[str]) -> None:
        """Remove the sentences about `topics`, whose problems have ended."""
        for topic in topics:
            self.by_topic.pop(topic, None)

    def warnings(self) -> Iterator[str]:
        """Yield the sentences up to the limit, then one with the number of further topics."""
        yield from islice(self.by_topic.values(), self._most)
        if len(self.by_topic) > self._most:
            yield f"{len(self.by_topic) - self._most} more topics {self._more}"

    def say(self, sentence: str) -> None:
        """Log a sentence, unless it was logged before, or MAX_SAID sentences were logged."""
        if sentence not in self._said and self._logged < MAX_SAID:
            self._said.add(sentence)
            self._logged += 1
            _log.warning("%s", sentence)


class QosMismatches(Sentences):
    """Finds QoS mismatches on topics. Hidden nodes are left out."""

    # A recorder's subscription for latched messages mismatches volatile publishers on purpose.
    def __init__(self, node: Node) -> None:
        super().__init__(MAX_NAMED, "have a QoS mismatch")
        self._node = node
        self._counts: dict[str, tuple[int, int]] = {}

    def look(self, topic: str, publishers: int) -> None:
        """Check the QoS on `topic` if its number of publishers or of subscriptions has changed."""
        counts = publishers, endpoints.subscription_count(self._node, topic)
        if counts == self._counts.get(topic):
            return
        self._counts[topic] = counts
        offers = endpoints.publishers(self._node, topic)
        if sentence := mismatch(topic, offers, endpoints.subscriptions(self._node, topic)):
            if sentence != self.by_topic.get(topic):
                self._said.discard(sentence)  # a mismatch is logged each time it begins
            self.note(topic, sentence)
        else:
            self.clear([topic])

    def forget(self, topic: str) -> None:
        """Forget a topic that is not recorded any more."""
        self._counts.pop(topic, None)
        self.clear([topic])


def mismatch(topic: str, publishers: Sequence[Endpoint], subscriptions: Sequence[Endpoint]) -> str:
    """Return a sentence on the first publisher and subscription that mismatch, "" if all match."""
    offers, requests = (
        [each for each in side if not each.node_name.startswith("_")][:MAX_ENDPOINTS]
        for side in (publishers, subscriptions)
    )
    for offer, request in product(offers, requests):
        if reason := _reason(offer.qos_profile, request.qos_profile):
            names = f"{full_name(request)} hears nothing of {full_name(offer)}"
            return f"{names} on {printable(topic)}: {reason}"
    return ""


def _reason(offered: QoSProfile, asked: QoSProfile) -> str:
    if (offered.reliability, asked.reliability) == (
        ReliabilityPolicy.BEST_EFFORT,
        ReliabilityPolicy.RELIABLE,
    ):
        return "reliability best_effort is offered, reliable asked for"
    if (offered.durability, asked.durability) == (
        DurabilityPolicy.VOLATILE,
        DurabilityPolicy.TRANSIENT_LOCAL,
    ):
        return "durability volatile is offered, transient_local asked for"
    return ""


MAX_WARNINGS = 50
"""Limit on the topics that `warnings` names."""


class Unrecorded(Sentences):
    """Collects the topics that are not recorded, or only in part, with the reason for each."""

    def __init__(self) -> None:
        super().__init__(MAX_WARNINGS, "are not recorded, or not whole")
        self._missed = 0
        self._last_missed = ""

    def miss(self, topic: str, type_name: str) -> None:
        """Count and report a topic that disappeared before its type was loaded."""
        self._missed += 1
        self._last_missed = f"{topic} ({type_name}) came and went before it could be recorded"
        self.say(self._last_missed)

    def warnings(self) -> Iterator[str]:
        """Yield the sentences about topics, then one on topics that came and went unrecorded."""
        yield from super().warnings()
        if self._missed:
            others = f" (and {self._missed - 1} other topics)" if self._missed > 1 else ""
            yield f"{self._last_missed}{others}"


@dataclass(frozen=True, slots=True)
class TopicDescription:
    """A topic with its type, definition and hash, and its publishers' QoS as YAML."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


def describe(name: str, type_name: str, offered: Iterable[QoSProfile]) -> TopicDescription:
    """Return the description of the topic `name` with the publishers' profiles `offered`."""
    text, type_hash = installed_type(type_name)
    return TopicDescription(name, type_name, text, type_hash, qos.to_yaml(offered))


POLL_S = 0.05
"""The time between two looks at the graph while it changes."""

CALM_S = 1.0
"""The time between two looks at the graph while rcl announces no change."""

LOOKS_PER_COUNT = 4
"""The number of looks at the graph between two counts of a tapped topic's publishers."""

# After a graph change, at least this number of looks come at POLL_S.
LOOKS_PER_INSPECTION = 40
"""The number of looks between two readings of a topic's QoS and types."""

TOPICS_PER_TURN = 50
"""Limit on the topics that are checked in one turn of the loop."""

ABANDONED_S = 60.0
"""The time without publishers after which a subscription ends. A node restarts sooner."""

RESERVED_FILES = 256
"""The number of descriptors (at most half) for other parts. Each subscription takes one."""

MAX_TYPES_NAMED = 5
"""Limit on the types that the sentence about a topic names."""


class TooManyTopics(Exception):
    """No more topics can be subscribed to, because of the limit on open files."""


class Tap:
    """Subscribes on node `_recorder` to every topic, with a QoS that its publishers match."""

    def __init__(
        self,
        session: Session,
        open_sink: Callable[[TopicDescription], ViewSink],
        wanted: Callable[[str, str], bool] = lambda topic, type_name: True,
    ) -> None:
        """Subscribe to topics with true `wanted(topic, type)`; `open_sink` returns their sinks."""
        self.node = session.helper()
        """The hidden node with all subscriptions of the tap."""

        self._resolve = session.resolve
        self._open_sink = open_sink
        self._wanted = wanted
        self._reserved: set[str] = set()
        self._own: set[str] = set()
        self._tapped: dict[str, TappedSubscription] = {}
        self._left_out: dict[str, list[str]] = {}
        """Topic that was left out -> its types. It is tried again when its types change."""

        self._failed: set[str] = set()
        """Topics with a failed subscription, which is tried again."""

        self._awaited: dict[str, str] = {}
        """Topic without a subscription yet -> its loading type."""

        self._types = TypeLoader()
        self._looks = count()
        self.unrecorded = Unrecorded()
        self.mismatches = QosMismatches(self.node)

    async def run(self) -> None:
        """Watch the graph until cancelled."""
        with GraphChanges(self.node) as changes:
            looks_left = LOOKS_PER_INSPECTION
            while True:
                await self._look()
                await self._types.pause(POLL_S)
                looks_left -= 1
                is_calm = looks_left <= 0 and not self._is_unfinished()
                if await changes.wait(CALM_S if is_calm else 0.0):
                    looks_left = LOOKS_PER_INSPECTION

    def subscribe_own(self, topic: OwnTopic) -> None:
        """Subscribe to a wanted topic of robotctl itself, even before its publisher exists."""
        name = self._resolve(topic.name)
        if self._wanted(name, topic.type_name):
            self._own.add(name)
            self._subscribe(name, topic.type_name, [topic.qos])

    def reserve(self, topic: OwnTopic) -> ViewSink:
        """Exclude a topic from subscription. Return its sink, a function that accepts messages."""
        name = self._resolve(topic.name)
        self._reserved.add(name)
        return self._open_sink(describe(name, topic.type_name, [topic.qos]))

    def _is_unfinished(self) -> bool:
        """Return whether topics need another look soon, even if the graph does not change."""
        abandoned = any(each.abandoned_since is not None for each in self._tapped.values())
        return abandoned or bool(self._failed or self._awaited)

    async def _look(self) -> None:
        look = next(self._looks)
        present = endpoints.topics(self.node)
        for number, (topic, type_names) in enumerate(present.items()):
            if number % TOPICS_PER_TURN == TOPICS_PER_TURN - 1:
                await asyncio.sleep(0)
            try:
                self._look_at(topic, type_names, (look + number) % LOOKS_PER_INSPECTION)
            except Exception as error:  # noqa: BLE001 - a foreign topic must not stop the others
                self._give_up(topic, type_names, error)
        for topic in self._awaited.keys() - present.keys():
            self.unrecorded.miss(topic, self._awaited.pop(topic))
        gone = (self._left_out.keys() | self.unrecorded.by_topic.keys()) - present.keys()
        for topic in gone:
            self._left_out.pop(topic, None)
            self._failed.discard(topic)
        self.unrecorded.clear(gone)

    def _look_at(self, topic: str, type_names: list[str], turn: int) -> None:
        tapped = self._tapped.get(topic)
        if tapped is not None:
            mixed = len(type_names) > 1 or topic in self.unrecorded.by_topic
            if mixed or turn % LOOKS_PER_COUNT == 0:
                self._follow(tapped, inspect=mixed or turn == 0)
        elif topic not in self._reserved:
            again = turn == 0 and topic in self._failed
            if again or self._left_out.get(topic) != type_names:
                self._tap(topic, type_names)

    def _tap(self, topic: str, type_names: list[str]) -> None:
        """Subscribe to the topic if it has a publisher, is wanted and its type can be loaded.

        Raises:
            Exception: rclpy or the sink failed.
        """
        if topic.startswith(announcements.TOPIC_PREFIX):
            return
        if not endpoints.is_topic_name(topic):
            if endpoints.publishers(self.node, topic):
                self._leave_out(topic, type_names, "ROS does not allow its name")
            return
        if not endpoints.publisher_count(self.node, topic):
            return
        offered = offered_types(self.node, topic)
        problem = ""
        for type_name in offered:
            if not self._wanted(topic, type_name):
                continue
            unusable = self._types.problem(type_name)
            if unusable is None:
                self._await(topic, type_name)
                return
            self._awaited.pop(topic, None)
            if not unusable:
                self._subscribe(topic, type_name, offered[type_name])
                self._failed.discard(topic)
                self._tell_types(topic, type_name, list(offered))
                return
            problem = f"it has type {short_name(type_name)}, which {unusable}"
        self._leave_out(topic, type_names, problem)

    def _await(self, topic: str, type_name: str) -> None:
        """Remember that the topic's type is loading. Note the topic if the load is slow."""
        self._awaited[topic] = type_name
        if self._types.is_slow(type_name):
            problem = f"its type {type_name} is not loaded after {SLOW_LOAD_S:g} s"
            self.unrecorded.note(topic, f"{topic} is not recorded yet: {problem}")

    def _leave_out(self, topic: str, type_names: list[str], problem: str) -> None:
        self._left_out[topic] = type_names
        if problem:
            self.unrecorded.note(topic, f"{short_name(topic)} is not recorded: {problem}")

    def _give_up(self, topic: str, type_names: list[str], error: Exception) -> None:
        """Note the reason for a failed subscription, and leave the topic out for now."""
        if isinstance(error, TooManyTopics):
            problem = f"there are {error}"
        elif len(type_names) > 1:
            types = ", ".join(map(short_name, sorted(type_names)[:MAX_TYPES_NAMED]))
            problem = f"its publishers and subscribers differ in its type: {types}"
            self._failed.add(topic)
        else:
            reason = printable(f"{type(error).__name__}: {error}")
            problem = f"it cannot be subscribed to ({reason})"
            self._failed.add(topic)
        if topic in self._tapped:
            self.unrecorded.note(topic, f"{topic} is not recorded: {problem}")
        else:
            self._leave_out(topic, type_names, problem)

    def _follow(self, tapped: TappedSubscription, *, inspect: bool) -> None:
        """Adapt the subscription to its publishers, or end it if none of its type is left."""
        topic = tapped.topic
        publishers = endpoints.publisher_count(self.node, topic)
        self.mismatches.look(topic, publishers)
        if publishers == tapped.publishers and not inspect:
            return
        tapped.publishers = publishers
        offered = offered_types(self.node, topic)
        if tapped.type_name in offered:
            tapped.abandoned_since = None
            tapped.adapt(offered[tapped.type_name])
        elif topic not in self._own and (offered or _is_abandoned(tapped)):
            self._tapped.pop(topic).close()  # with another type it is tapped again
            self.mismatches.forget(topic)
            return
        self._tell_types(topic, tapped.type_name, list(offered))

    def _tell_types(self, topic: str, recorded: str, published: list[str]) -> None:
        """Note the types of a topic that are published but not recorded."""
        names = [short_name(name) for name in published if name != recorded]
        others = ", ".join(names[:MAX_TYPES_NAMED])
        if len(names) > MAX_TYPES_NAMED:
            others += f" and {len(names) - MAX_TYPES_NAMED} more"
        if others:
            self.unrecorded.note(topic, f"{topic} is recorded as {recorded}, not as {others}")
        else:
            self.unrecorded.clear([topic])

    def _subscribe(self, topic: str, type_name: str, offered: list[QoSProfile]) -> None:
        """Subscribe to a topic with a loaded type.

        Raises:
            TooManyTopics: The remaining file descriptors are reserved.
            Exception: rclpy or the sink failed.
        """
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if len(self._tapped) >= max(limit - RESERVED_FILES, limit // 2):
            raise TooManyTopics(f"more topics than {limit} open files allow (see ulimit -n)")
        sink = self._open_sink(describe(topic, type_name, offered))
        self._tapped[topic] = TappedSubscription(self.node, topic, type_name, sink, offered)


def _is_abandoned(tapped: TappedSubscription) -> bool:
    """Note when a topic lost its last publisher. Return whether ABANDONED_S have passed since."""
    now = time.monotonic()
    if tapped.abandoned_since is None:
        tapped.abandoned_since = now
    return now >= tapped.abandoned_since + ABANDONED_S
