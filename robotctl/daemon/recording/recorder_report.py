"""The state of the recording, for `status`, the log and /diagnostics."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import cast

import msgspec

from robotctl.ipc.advice import for_robot
from robotctl.ipc.answers import RecordingFacts, TopicAnswer
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording import Recorder, RecorderState, RecorderStats
from robotctl.recording.format.topics import COUNTERS, TopicStats, by_topic
from robotctl.recording.write.recorder_options import TopicFilter
from robotctl.ros.nodes.publishers import Diagnosis, DiagnosticLevel

HEAVY_BYTES_PER_S = 5e6
HEAVY_WINDOW_S = 5.0
"""Length of the window in which the data rate of a heavy topic is averaged."""

CALM_SHARE = 0.5
"""Share of the limit below which a heavy topic is no longer heavy."""

TopicKey = tuple[str, str]
"""Name and type of a topic."""


class RateMeter:
    """Computes message rates [1/s] from the last two samples of message counts, rounded to 0.01."""

    def __init__(self) -> None:
        self._counts: Mapping[TopicKey, int] = {}
        self.rates: Mapping[TopicKey, float] = {}
        """The latest rates, a new object after each sample."""

        self._t_ns = 0

    def sample(self, t_ns: int, counts: Mapping[TopicKey, int]) -> None:
        """Compute the rates since the last call from `counts` at the steady time `t_ns`."""
        hundredths = 100 * NS_PER_S / (t_ns - self._t_ns)
        self.rates = {
            topic: round((count - self._counts.get(topic, 0)) * hundredths) / 100
            for topic, count in counts.items()
        }
        self._counts, self._t_ns = counts, t_ns


class HeavyTopics:
    """Finds the topics with a data rate [bytes/s] above HEAVY_BYTES_PER_S."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Mapping[TopicKey, int]]] = deque()
        self.rates: Mapping[TopicKey, float] = {}
        """Data rates [bytes/s] of the heavy topics over the last HEAVY_WINDOW_S."""

    def sample(self, t_ns: int, sizes: Mapping[TopicKey, int]) -> None:
        """Update `rates`. `sizes` has the bytes received by topic until the steady time `t_ns`."""
        samples = self._samples
        samples.append((t_ns, sizes))
        while len(samples) > 2 and t_ns - samples[1][0] >= HEAVY_WINDOW_S * NS_PER_S:
            samples.popleft()
        first_ns, before = samples[0]
        elapsed_s = (t_ns - first_ns) / NS_PER_S
        if elapsed_s < HEAVY_WINDOW_S:
            return
        rates = {topic: (size - before.get(topic, 0)) / elapsed_s for topic, size in sizes.items()}
        self.rates = {
            topic: rate
            for topic, rate in rates.items()
            if rate > HEAVY_BYTES_PER_S * (CALM_SHARE if topic in self.rates else 1.0)
        }


class _Row(msgspec.Struct):
    """A TopicAnswer as a struct, which is encoded in 60 % of the time for a dict."""

    name: str
    type: str
    count: int
    rate: float
    bytes: int
    written: int
    queued: int
    dropped: int
    lost: int
    throttled: int
    unseen: int


def topic_rows(topics: Sequence[TopicStats], rates: Mapping[TopicKey, float]) -> msgspec.Raw:
    """Return the topics of the status as a JSON list. Topics missing in `rates` have the rate 0."""
    rows = [
        _Row(
            each.name,
            each.type_name,
            each.received,
            rates.get((each.name, each.type_name), 0.0),
            each.bytes,
            each.written,
            each.queued,
            each.dropped,
            each.lost,
            each.throttled,
            each.unseen,
        )
        for each in sorted(by_topic(topics), key=lambda each: (each.name, each.type_name))
    ]
    return msgspec.Raw(msgspec.json.encode(rows))


MAX_TOPICS = 100
"""Limit on the topics that a diagnosis lists, those with the most missing messages."""


def diagnose(stats: RecorderStats, warnings: Sequence[str]) -> Diagnosis:
    """Return the recorder's state as a diagnosis for /diagnostics."""
    if stats.state is not RecorderState.RECORDING:
        level, message = DiagnosticLevel.ERROR, stats.failure or stats.state.value
    elif stats.dropped or stats.lost:
        level, message = DiagnosticLevel.WARN, _lacking(stats.dropped, stats.lost)
    elif warnings:
        level, message = DiagnosticLevel.WARN, warnings[0]
    else:
        level, message = DiagnosticLevel.OK, "everything is recorded"
    return Diagnosis("recorder", level, message, dict(_values(stats)))


def _values(stats: RecorderStats) -> Iterator[tuple[str, str]]:
    yield "state", stats.state.value
    yield "file", str(stats.file)
    for name in ("bytes", *COUNTERS):
        yield name, str(getattr(stats, name))
    lacking = [topic for topic in by_topic(stats.topics) if topic.dropped or topic.lost]
    lacking.sort(key=lambda topic: (-topic.dropped - topic.lost, topic.name))
    yield from ((each.name, _lacking(each.dropped, each.lost)) for each in lacking[:MAX_TOPICS])


def _lacking(dropped: int, lost: int) -> str:
    return f"{dropped} messages dropped, {lost} lost on their way here"


_log = logging.getLogger(__name__)

NO_MEMORY = "are not recorded, because memory ran out: end other programs, or exclude large topics"


class RecorderReport:
    """Reports the counts of the recorder."""

    def __init__(
        self,
        recorder: Recorder,
        topic_filter: TopicFilter,
        robot: str,
    ) -> None:
        self._recorder = recorder
        self._filter = topic_filter
        self._robot = robot
        self._rates = RateMeter()
        self._heavy = HeavyTopics()
        self._logged: set[str] = set()
        self._logged_memory = False

    def stats(self) -> RecorderStats:
        """Return the recorder's present counts, which the other methods get as `stats`."""
        return self._recorder.stats()

    def facts(self, stats: RecorderStats) -> RecordingFacts:
        """Return the recording's part of the status."""
        return {
            # This is JSON already, which the encoder of the answer copies.
            "topics": cast(list[TopicAnswer], topic_rows(stats.topics, self._rates.rates)),
            "recorder": {
                "state": stats.state.value,
                "file": str(stats.file),
                "bytes": stats.bytes,
                "received": stats.received,
                "written": stats.written,
                "queued": stats.queued,
                "dropped": stats.dropped,
                "lost": stats.lost,
                "throttled": stats.throttled,
            },
        }

    def sample(self, stats: RecorderStats) -> None:
        """Update the rates. Call this once a second."""
        now_ns = time.monotonic_ns()
        topics = {(each.name, each.type_name): each for each in by_topic(stats.topics)}
        self._rates.sample(now_ns, {key: topic.received for key, topic in topics.items()})
        self._heavy.sample(now_ns, {key: topic.bytes for key, topic in topics.items()})
        for topic, warning in self.heavy_warnings():
            if topic not in self._logged:
                self._logged.add(topic)
                _log.warning("%s", warning)
        if stats.no_memory and not self._logged_memory:
            self._logged_memory = True
            _log.warning("messages %s", NO_MEMORY)

    def diagnosis(self, stats: RecorderStats, warnings: Sequence[str]) -> Diagnosis:
        """Return the recorder's diagnosis, with `--robot NAME` in commands that it suggests."""
        return diagnose(replace(stats, failure=for_robot(stats.failure, self._robot)), warnings)

    def heavy_warnings(self) -> Iterator[tuple[str, str]]:
        """Yield (topic, warning) for each heavy topic that may be excluded from recordings."""
        for (topic, _), bytes_per_s in self._heavy.rates.items():
            if self._filter.can_leave_out(topic):
                rate = f"{topic} brings {bytes_per_s / 1e6:.1f} MB/s"
                cure = f"robotctl start --exclude {topic} leaves it out of the recording"
                yield topic, for_robot(f"{rate}: {cure}", self._robot)
