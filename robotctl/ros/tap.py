"""Every topic of the graph as raw bytes, handed to a sink that neither knows nor needs ROS."""

from __future__ import annotations

import asyncio
import logging
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any

from rclpy.qos import QoSProfile

from robotctl.ros import proof, qos
from robotctl.ros.message_types import message_class
from robotctl.ros.raw import Sink
from robotctl.ros.session import RECORDER_NODE, Session
from robotctl.ros.tapped import LATENCY_S, TappedSubscription
from robotctl.ros.type_definition import definition_of, type_hash_of

_log = logging.getLogger(__name__)

POLL_S = 0.05
"""A foreign topic is found within twice this."""

LOOKS_PER_COUNT = 4
"""Every so many looks the publishers of a topic that is tapped are counted..."""

LOOKS_PER_INSPECTION = 20
"""...and inspected, also where their number is the same: one may have replaced another."""

TOPICS_PER_TURN = 50
"""Looked at in one turn of the loop, which has more urgent things to do."""

ABANDONED_S = 60.0
"""A topic that nobody publishes for so long is given back; a node that restarts is awaited."""

RESERVED_FILES = 256
"""Open files that the rest of the process may need; each subscription takes one."""


@dataclass(frozen=True, slots=True)
class TappedTopic:
    """What a recording must know of a topic before its first message."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


class TooManyTopics(Exception):
    """Another subscription would take what the rest of the process needs."""


class Tap:
    """Node `recorder`; subscribes to every topic that appears, once, whatever its publishers offer.

    `open_sink` is called in the loop for each new topic and returns what takes its messages.
    `wanted(topic, type)` says which to take.
    """

    def __init__(
        self,
        session: Session,
        open_sink: Callable[[TappedTopic], Sink],
        wanted: Callable[[str, str], bool] = lambda topic, type_name: True,
    ) -> None:
        self._node = session.node(RECORDER_NODE)
        self._open_sink = open_sink
        self._wanted = wanted
        self._reserved: set[str] = set()
        self._own: set[str] = set()
        self._tapped: dict[str, TappedSubscription] = {}
        self._left_out: dict[str, list[str]] = {}
        """Topic -> its types when it was found that none of them is to be taken."""

        self._looks = count()
        self._said: set[str] = set()
        self.problems: dict[str, str] = {}
        """Topic -> a sentence on what of it is not recorded."""

    async def run(self) -> None:
        """Watch the graph until cancelled."""
        while True:
            await self._look()
            await asyncio.sleep(POLL_S)

    def subscribe_own(
        self,
        name: str,
        type_name: str,
        offered: QoSProfile,
        *,
        heard: Callable[[bytes], None] | None = None,
        latency_s: float = LATENCY_S,
    ) -> Callable[[], None]:
        """Tap a topic of ours, before its publisher exists; `heard(gid)` is told of each message.

        Messages collect for `latency_s`, or until the function is called that this returns.
        """
        topic = self._node.resolve_topic_name(name)
        if self._wanted(topic, type_name):
            self._own.add(topic)
            self._subscribe(topic, type_name, [offered], heard, latency_s)

        def look() -> None:
            tapped = self._tapped.get(topic)
            if tapped is not None:
                tapped.look()

        return look

    def reserve(self, topic: TappedTopic) -> Sink:
        """Return the sink of a topic whose messages come to it from elsewhere, not from here."""
        self._reserved.add(topic.name)
        return self._open_sink(topic)

    async def _look(self) -> None:
        look = next(self._looks)
        present = dict(self._node.get_topic_names_and_types())
        for number, (topic, type_names) in enumerate(present.items()):
            if number % TOPICS_PER_TURN == TOPICS_PER_TURN - 1:
                await asyncio.sleep(0)
            tapped = self._tapped.get(topic)
            turn = (look + number) % LOOKS_PER_INSPECTION
            if tapped is not None:
                mixed = len(type_names) > 1 or topic in self.problems
                if mixed or turn % LOOKS_PER_COUNT == 0:
                    self._follow(tapped, inspect=mixed or turn == 0)
            elif self._left_out.get(topic) != type_names and topic not in self._reserved:
                await self._tap(topic, type_names)
        for topic in (self._left_out.keys() | self.problems.keys()) - present.keys():
            self._left_out.pop(topic, None)
            self.problems.pop(topic, None)

    async def _tap(self, topic: str, type_names: list[str]) -> None:
        """Subscribe to what is published there, if it can be had and is wanted."""
        if not self._node.count_publishers(topic) or topic.startswith(proof.TOPIC_PREFIX):
            return
        offered = self._offered(topic)
        problem = ""
        for type_name in offered:
            if not self._wanted(topic, type_name):
                continue
            try:
                # Loading a foreign type takes tens of milliseconds, which the loop does not have.
                await asyncio.to_thread(_load, type_name)
                self._subscribe(topic, type_name, offered[type_name])
            except ImportError:
                problem = f"it has type {type_name}, which is not installed"
            except TooManyTopics as error:
                problem = f"there are {error}"
            except Exception as error:  # noqa: BLE001 - somebody else's topic must not stop us
                problem = f"it cannot be subscribed to ({type(error).__name__}: {error})"
            else:
                self._tell_types(topic, type_name, list(offered))
                return
        self._left_out[topic] = type_names
        if problem:
            self._note(topic, f"{topic} is not recorded: {problem}")

    def _follow(self, tapped: TappedSubscription, *, inspect: bool) -> None:
        """Go along with publishers that come and go, and with what they offer."""
        topic = tapped.topic
        publishers = self._node.count_publishers(topic)
        if publishers == tapped.publishers and not inspect:
            return
        tapped.publishers = publishers
        offered = self._offered(topic)
        if tapped.type_name in offered:
            tapped.abandoned_since = None
            tapped.adapt(offered[tapped.type_name])
        elif topic not in self._own and (offered or _is_abandoned(tapped)):
            self._tapped.pop(topic).close()  # what came back as something else is tapped anew
            return
        self._tell_types(topic, tapped.type_name, list(offered))

    def _tell_types(self, topic: str, recorded: str, published: list[str]) -> None:
        """Name the types of a topic that are published and not recorded."""
        others = ", ".join(name for name in published if name != recorded)
        if others:
            self._note(topic, f"{topic} is recorded as {recorded}, not as {others}")
        else:
            self.problems.pop(topic, None)

    def _note(self, topic: str, problem: str) -> None:
        self.problems[topic] = problem
        if problem not in self._said:
            self._said.add(problem)
            _log.warning("%s", problem)

    def _subscribe(
        self,
        topic: str,
        type_name: str,
        offered: list[QoSProfile],
        heard: Callable[[bytes], None] | None = None,
        latency_s: float = LATENCY_S,
    ) -> None:
        """Raises whatever rclpy raises, and TooManyTopics."""
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if len(self._tapped) >= max(limit - RESERVED_FILES, limit // 2):
            raise TooManyTopics(f"more topics than {limit} open files allow (see ulimit -n)")
        definition, type_hash = definition_of(type_name), type_hash_of(type_name)
        described = TappedTopic(topic, type_name, definition, type_hash, qos.to_yaml(offered))
        sink = self._open_sink(described)
        if heard is not None:
            sink = _overheard(sink, heard)
        self._tapped[topic] = TappedSubscription(
            self._node, topic, type_name, sink, offered, latency_s
        )

    def _offered(self, topic: str) -> dict[str, list[QoSProfile]]:
        """What the publishers of a topic offer, by its types; the one with most comes first."""
        found: dict[str, list[QoSProfile]] = {}
        for info in self._node.get_publishers_info_by_topic(topic):
            found.setdefault(info.topic_type, []).append(info.qos_profile)
        return dict(sorted(found.items(), key=lambda entry: (-len(entry[1]), entry[0])))


def _overheard(sink: Sink, heard: Callable[[bytes], None]) -> Sink:
    """Return a sink that tells of the publisher of each message, once it is recorded."""

    def take(data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes) -> None:
        sink(data, received_ns, source_ns, sequence, gid)
        heard(gid)

    return take


def _is_abandoned(tapped: TappedSubscription) -> bool:
    """Whether nobody has published the topic for long; to be asked while nobody does."""
    now = time.monotonic()
    if tapped.abandoned_since is None:
        tapped.abandoned_since = now
    return now >= tapped.abandoned_since + ABANDONED_S


def _load(type_name: str) -> Any:
    message_type = message_class(type_name)
    definition_of(type_name)
    type_hash_of(type_name)
    return message_type
