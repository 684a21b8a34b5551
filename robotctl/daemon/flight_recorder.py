"""The flight recorder: what comes off the graph goes into the recording, and is accounted for."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

from robotctl.config import Config
from robotctl.daemon.options import DaemonOptions
from robotctl.daemon.recordings import open_recorder
from robotctl.daemon.statistics import RateMeter
from robotctl.daemon.supervisor import Work
from robotctl.recording.events import RecordedEvent
from robotctl.recording.recorder import Topic
from robotctl.recording.topic_filter import TopicFilter
from robotctl.ros.journal_publisher import JournalPublisher
from robotctl.ros.raw import UNKNOWN_GID, Sink
from robotctl.ros.session import Session
from robotctl.ros.tap import Tap, TappedTopic

_log = logging.getLogger(__name__)

SAMPLE_PERIOD_S = 1.0


class FlightRecorder:
    """Recorder and tap; it records from here on, foreign topics while its work runs.

    What proves a drive is recorded whatever the filters say: command, odometry, robot status and
    journal.
    """

    def __init__(
        self,
        options: DaemonOptions,
        config: Config,
        session: Session,
        mode: Callable[[], str],
        on_failure: Callable[[str], None],
        on_split: Callable[[Path], None],
    ) -> None:
        """`mode` is asked, `on_failure` and `on_split` come from the writer thread; see Recorder.

        Raises Refused where nothing can be written.
        """
        self._recorder = open_recorder(
            options.recordings, options.robot, config, mode, on_failure, on_split
        )
        self._rates = RateMeter()
        proof = (config.kernel.command.topic, config.kernel.odometry.topic, "robot_status")
        self._filter = TopicFilter(
            config.recording.include, config.recording.exclude, map(session.resolve, proof)
        )
        self.tap = Tap(session, self._open_sink, self._filter.records)

    def work(self) -> dict[str, Work]:
        """Return the tasks."""
        return {"recorder": self.tap.run, "recorder's statistics": self._keep_statistics}

    def open_journal(self, publisher: JournalPublisher) -> Callable[[bytes, int], None]:
        """Return what records and publishes an entry, given serialized and with its number."""
        write = self.tap.reserve(publisher.description)

        def write_entry(serialized: bytes, seq: int) -> None:
            now_ns = time.time_ns()
            write(serialized, now_ns, now_ns, seq + 1, UNKNOWN_GID)
            publisher.publish(serialized)

        return write_entry

    def note(self, event: RecordedEvent) -> None:
        """Name an event in the recording's metadata."""
        self._recorder.note(event)

    def received(self) -> dict[str, int]:
        """Return how many messages of each topic were received."""
        return {topic.name: topic.received for topic in self._recorder.stats().topics}

    def facts(self) -> dict[str, Any]:
        """Return what `status` tells of the recording."""
        stats = self._recorder.stats()
        return {
            "topics": [
                {
                    "name": topic.name,
                    "type": topic.type_name,
                    "count": topic.received,
                    "rate": self._rates.rate(topic.name),
                }
                for topic in sorted(stats.topics, key=lambda topic: topic.name)
            ],
            "recorder": {
                "state": stats.state.value,
                "file": str(stats.file),
                "bytes": stats.bytes,
                "received": stats.received,
                "written": stats.written,
                "queued": stats.queued,
                "dropped": stats.dropped,
                "lost": stats.lost,
            },
        }

    def warnings(self) -> Iterator[str]:
        """Say what is not recorded, and why."""
        stats = self._recorder.stats()
        yield from (text for text in (stats.failure, stats.warning) if text)
        yield from self.tap.problems.values()

    def sample(self) -> None:
        """Take the counts that rates are made of."""
        self._rates.sample(time.monotonic_ns(), self.received().items())

    async def close(self) -> None:
        """Finish the recording; the disk is not waited for in the loop."""
        stats = await asyncio.to_thread(self._recorder.close)
        _log.info(
            "recorded %d messages in %s, %d dropped, %d lost",
            stats.written,
            stats.file,
            stats.dropped,
            stats.lost,
        )

    async def discard(self) -> None:
        """Leave nothing behind of a start that failed before anything ran."""
        stats = await asyncio.to_thread(self._recorder.close)
        await asyncio.to_thread(rmtree, stats.file.parent, ignore_errors=True)

    async def _keep_statistics(self) -> None:
        while True:
            self.sample()
            await asyncio.sleep(SAMPLE_PERIOD_S)

    def _open_sink(self, topic: TappedTopic) -> Sink:
        described = Topic(
            topic.name, topic.type_name, topic.definition, topic.type_hash, topic.offered_qos
        )
        return partial(self._recorder.write, self._recorder.add_topic(described))
