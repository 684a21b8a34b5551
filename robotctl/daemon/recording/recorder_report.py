"""The state of the recording, for `status`, the log and /diagnostics."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
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

_log = logging.getLogger(__name__)

NO_MEMORY = "are not recorded, because memory ran out: end other programs, or exclude large topics"


class RecorderReport:
    """A report of the counts of the recorder, with cures for `robot`."""

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
            _log.warning("messages %s", NO_MEMORY)

    def diagnosis(self, stats: RecorderStats, warnings: Sequence[str]) -> Diagnosis:
        """Return the recorder's part of /diagnostics; the warnings are those of the recorder."""
        told = replace(stats, failure=for_robot(stats.failure, self._robot))
        return diagnose(told, warnings)

    def heavy_warnings(self) -> Iterator[tuple[str, str]]:
        """Yield each heavy topic that can be excluded, with its warning."""
        for (topic, _), bytes_per_s in self._heavy.rates.items():
            if self._filter.can_leave_out(topic):
                rate = f"{topic} brings {bytes_per_s / 1e6:.1f} MB/s"
                cure = f"robotctl start --exclude {topic} leaves it out of the recording"
                yield topic, for_robot(f"{rate}: {cure}", self._robot)

    def _log_heavy(self) -> None:
        """Log the warning of each heavy topic once."""
        for topic, warning in self.heavy_warnings():
            if topic not in self._logged:
                self._logged.add(topic)
                _log.warning("%s", warning)
