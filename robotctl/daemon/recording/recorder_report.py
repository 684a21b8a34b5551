"""The state of the recording, for `status`, the log and /diagnostics."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import cast

from robotctl.daemon.recording.loss_diagnosis import diagnose
from robotctl.daemon.recording.topic_rates import HeavyTopics, RateMeter
from robotctl.daemon.recording.topic_rows import TopicRows
from robotctl.ipc.advice import for_robot
from robotctl.ipc.answers import RecordingFacts, TopicAnswer
from robotctl.recording import Recorder, RecorderStats
from robotctl.recording.format.topics import by_topic
from robotctl.recording.write.recorder_options import TopicFilter
from robotctl.ros.nodes.publishers import Diagnosis
from robotctl.ros.tap.tap import Tap

_log = logging.getLogger(__name__)

_NO_MEMORY = "are not recorded, because memory ran out: end other programs, or exclude large topics"


class RecorderReport:
    """A report of the counts of recorder and tap."""

    def __init__(
        self,
        recorder: Recorder,
        tap: Tap,
        topic_filter: TopicFilter,
        problems: Callable[[], Sequence[str]],
        robot: str,
    ) -> None:
        """`problems()` returns those of other recordings in the folder, and of the seal's heads."""
        self._recorder = recorder
        self._tap = tap
        self._filter = topic_filter
        self._problems = problems
        self._robot = robot
        self._rates = RateMeter()
        self._rows = TopicRows()
        self._heavy = HeavyTopics()
        self._logged: set[str] = set()
        self._logged_memory = False

    def stats(self) -> RecorderStats:
        """Return the counts of now, which the other methods explain."""
        return self._recorder.stats()

    def facts(self, stats: RecorderStats) -> RecordingFacts:
        """Return the recording's part of the status."""
        return {
            # In JSON already, which the encoder of the answer takes as it is.
            "topics": cast(list[TopicAnswer], self._rows.encoded(stats.topics, self._rates.rates)),
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

    def warnings(self, stats: RecorderStats) -> Iterator[str]:
        """Yield what is not recorded and why, with commands for this robot."""
        yield from (for_robot(text, self._robot) for text in self._warnings(stats))

    def _warnings(self, stats: RecorderStats) -> Iterator[str]:
        yield from (text for text in (stats.failure, stats.warning) if text)
        if stats.no_memory:
            yield f"{stats.no_memory} messages {_NO_MEMORY}"
        if stats.dropped > stats.no_memory and not stats.failure:
            worst = max(stats.topics, key=lambda topic: topic.dropped)
            yield (
                f"{stats.dropped} messages are not recorded, most of {worst.name}: "
                "they came faster than the disk writes, or are larger than the queue"
            )
        if stats.not_repeated:
            yield (
                f"{stats.not_repeated} latched messages are recorded once and not repeated in "
                "later files: together they are larger than the room kept for that"
            )
        yield from self._tap.unrecorded.warnings()
        yield from self._tap.mismatches.warnings()
        yield from (warning for _, warning in self._heavy_warnings())
        yield from self._problems()

    def sample(self, stats: RecorderStats) -> None:
        """Update the rates; called once a second."""
        now_ns = time.monotonic_ns()
        topics = {(each.name, each.type_name): each for each in by_topic(stats.topics)}
        self._rates.sample(now_ns, {key: topic.received for key, topic in topics.items()})
        sizes = {key: topic.bytes for key, topic in topics.items()}
        self._heavy.sample(now_ns, sizes)
        self._log_heavy()
        if stats.no_memory and not self._logged_memory:
            self._logged_memory = True
            _log.warning("messages %s", _NO_MEMORY)

    def diagnosis(self, stats: RecorderStats) -> Diagnosis:
        """Return the recorder's part of /diagnostics."""
        told = replace(stats, failure=for_robot(stats.failure, self._robot))
        return diagnose(told, list(self.warnings(stats)))

    def _heavy_warnings(self) -> Iterator[tuple[str, str]]:
        """Yield each heavy topic that can be excluded, with its warning."""
        for (topic, _), bytes_per_s in self._heavy.rates.items():
            if self._filter.can_leave_out(topic):
                rate = f"{topic} brings {bytes_per_s / 1e6:.1f} MB/s"
                cure = f"robotctl start --exclude {topic} leaves it out of the recording"
                yield topic, for_robot(f"{rate}: {cure}", self._robot)

    def _log_heavy(self) -> None:
        """Log the warning of each heavy topic once."""
        for topic, warning in self._heavy_warnings():
            if topic not in self._logged:
                self._logged.add(topic)
                _log.warning("%s", warning)
