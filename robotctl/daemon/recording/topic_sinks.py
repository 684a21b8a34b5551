"""The sinks of recorded topics, throttled if configured and watched by TopicHealth."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from math import inf

from robotctl.config import RecordingParams
from robotctl.daemon.recording.topic_health import LOOK_S, TopicHealth, may_be_learned
from robotctl.recording import Recorder, Topic
from robotctl.recording.write.recorder import MessageGate
from robotctl.recording.write.recorder_options import RateByTopic, is_plain_name
from robotctl.ros.executor import ViewSink
from robotctl.ros.tap.tap import TopicDescription


class TopicSinks:
    """Opens sinks that pass the messages of topics to the recorder; for the loop's thread.

    `is_own(topic)` is true for robotctl's topics, `is_evidence(topic)` for topics that a check
    needs. Own, evidence and latched topics are never throttled.
    """

    def __init__(
        self,
        recorder: Recorder,
        params: RecordingParams,
        *,
        is_own: Callable[[str], bool],
        is_evidence: Callable[[str], bool],
    ) -> None:
        self._recorder = recorder
        self._is_own = is_own
        self._is_evidence = is_evidence
        self._most = RateByTopic(params.throttle)
        self._has_reserve = params.min_free_gb > 0.0
        self.gates: dict[str, list[MessageGate]] = {}
        """The gates of each topic that may be throttled or stopped."""

        self._sinks: dict[int, ViewSink] = {}
        """The sinks by channel."""

        expected = (each.rpartition("=") for each in params.expected_rates)
        named = [name for name, _, rate in expected if is_plain_name(name) and float(rate)]
        self.health = TopicHealth(RateByTopic(params.expected_rates), named, time.monotonic())
        self.on_news: Callable[[], None] = lambda: None
        """Called when `TopicHealth.look` has found a change."""

        self.on_troubles: Callable[[str], None] | None = None
        """Called with `TopicHealth.troubles()` after each change of this text."""

    async def watch(self) -> None:
        """Update the health of all topics every LOOK_S and report changes, until cancelled."""
        told = ""
        while True:
            if self.on_troubles is not None and told != (told := self.health.troubles()):
                self.on_troubles(told)
            await asyncio.sleep(LOOK_S)
            if self.health.look(time.monotonic(), time.time_ns()):
                self.on_news()

    def open(self, topic: TopicDescription) -> ViewSink:
        """Register the topic with the recorder, and return the sink for the topic's messages."""
        described = Topic(
            topic.name, topic.type_name, topic.definition, topic.type_hash, topic.offered_qos
        )
        channel = self._recorder.add_topic(described)
        if channel not in self._sinks:
            self._sinks[channel] = self._new_sink(described, channel)
        return self._sinks[channel]

    def _new_sink(self, topic: Topic, channel: int) -> ViewSink:
        is_own = self._is_own(topic.name)
        learns = not (is_own or topic.latched) and may_be_learned(topic.name, topic.type_name)
        self.health.add(
            topic.name,
            topic.type_name,
            self._recorder.channel(channel),
            learns=learns,
            now_s=time.monotonic(),
        )
        if is_own or topic.latched or self._is_evidence(topic.name):
            return partial(self._recorder.write, channel)
        most_hz = self._most.of(topic.name, topic.type_name)
        if most_hz is None and not self._has_reserve:
            return partial(self._recorder.write, channel)
        gate = MessageGate(self._recorder, channel, inf if most_hz is None else most_hz)
        others = self.gates.setdefault(topic.name, [])
        gate.is_shut = any(each.is_shut for each in others)
        others.append(gate)
        return gate
