"""Every topic of the graph as raw bytes, handed to a sink that neither knows nor needs ROS."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from robotctl.ros import qos
from robotctl.ros.message_types import message_class
from robotctl.ros.raw import RawTap, Sink
from robotctl.ros.session import Session
from robotctl.ros.type_definition import definition_of, type_hash_of

_log = logging.getLogger(__name__)

LATENCY_S = 0.05
"""How long messages may wait to be taken together: waking costs more than taking. Their times
are the middleware's, so nothing shows in the recording."""

POLL_S = 0.05
"""A foreign topic is found within twice this."""


@dataclass(frozen=True, slots=True)
class TappedTopic:
    """What a recording must know of a topic before its first message."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


@dataclass(slots=True)
class _Tapped:
    type_name: str
    subscription: Subscription
    requested: QoSProfile
    publishers: int


class Tap:
    """Node `recorder`; subscribes to every topic that appears, once, whatever its publishers offer.

    `open_sink` is called in the loop for each new topic and returns what takes its messages.
    """

    def __init__(self, session: Session, open_sink: Callable[[TappedTopic], Sink]) -> None:
        self._node = session.node("recorder")
        self._open_sink = open_sink
        self._reserved: set[str] = set()
        self._tapped: dict[str, _Tapped] = {}
        self._sinks: dict[str, Sink] = {}
        self.problems: dict[str, str] = {}
        """Topic -> a sentence on what of it is not recorded."""

    async def run(self) -> None:
        """Watch the graph until cancelled."""
        while True:
            await self._look()
            await asyncio.sleep(POLL_S)

    def subscribe_own(self, name: str, type_name: str, offered: QoSProfile) -> None:
        """Tap a topic of ours, before its publisher exists."""
        topic = self._node.resolve_topic_name(name)
        self._subscribe(topic, type_name, message_class(type_name), [offered])

    def reserve(self, topic: TappedTopic) -> Sink:
        """Return the sink of a topic whose messages come to it from elsewhere, not from here."""
        self._reserved.add(topic.name)
        return self._open_sink(topic)

    async def _look(self) -> None:
        for topic, type_names in self._node.get_topic_names_and_types():
            if topic in self._reserved:
                continue
            tapped = self._tapped.get(topic)
            if tapped is not None:
                self._adapt(topic, type_names, tapped)
            elif topic not in self.problems:
                await self._tap(topic, type_names)

    async def _tap(self, topic: str, type_names: list[str]) -> None:
        if not self._node.count_publishers(topic):
            return
        if len(type_names) > 1:
            self._give_up(topic, f"has several types ({', '.join(type_names)})")
            return
        (type_name,) = type_names
        try:
            # Loading a foreign type takes tens of milliseconds, which the loop does not have.
            message_type = await asyncio.to_thread(_load, type_name)
        except ImportError:
            self._give_up(topic, f"has type {type_name}, which is not installed")
            return
        try:
            self._subscribe(topic, type_name, message_type, self._offered(topic))
        except Exception as error:  # noqa: BLE001 - somebody else's topic must not stop our robot
            self._give_up(topic, f"cannot be subscribed to ({type(error).__name__}: {error})")

    def _give_up(self, topic: str, reason: str) -> None:
        self._note(topic, f"{topic} is not recorded: it {reason}")

    def _note(self, topic: str, problem: str) -> None:
        if self.problems.get(topic) != problem:
            self.problems[topic] = problem
            _log.warning("%s", problem)

    def _adapt(self, topic: str, type_names: list[str], tapped: _Tapped) -> None:
        """Ask for what newly come publishers can give, where they offer less."""
        others = [name for name in type_names if name != tapped.type_name]
        if others:
            found = ", ".join(others)
            self._note(topic, f"{topic} is recorded as {tapped.type_name}, not as {found}")
        else:
            self.problems.pop(topic, None)
        publishers = self._node.count_publishers(topic)
        if publishers == tapped.publishers:
            return
        tapped.publishers = publishers
        offered = self._offered(topic)
        wanted = qos.recording(offered)
        if offered and wanted != tapped.requested:
            self._node.destroy_subscription(tapped.subscription)
            tapped.subscription = self._create(tapped.subscription.msg_type, topic, wanted)
            tapped.requested = wanted

    def _subscribe(
        self, topic: str, type_name: str, message_type: Any, offered: list[QoSProfile]
    ) -> None:
        self._sinks[topic] = self._open_sink(
            TappedTopic(
                topic,
                type_name,
                definition_of(type_name),
                type_hash_of(type_name),
                qos.to_yaml(offered),
            )
        )
        wanted = qos.recording(offered)
        subscription = self._create(message_type, topic, wanted)
        self._tapped[topic] = _Tapped(type_name, subscription, wanted, 0)

    def _create(self, message_type: Any, topic: str, wanted: QoSProfile) -> Subscription:
        # rclpy's own types know a callback of one argument only.
        sink: Any = RawTap(self._sinks[topic], latency_s=LATENCY_S)
        return self._node.create_subscription(message_type, topic, sink, wanted, raw=True)

    def _offered(self, topic: str) -> list[QoSProfile]:
        return [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]


def _load(type_name: str) -> Any:
    message_type = message_class(type_name)
    definition_of(type_name)
    type_hash_of(type_name)
    return message_type
