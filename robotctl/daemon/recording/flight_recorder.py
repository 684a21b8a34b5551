"""The flight recorder: records the ROS graph, and counts every message."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

from robotctl.base.paths import log_path, seal_folder
from robotctl.config import Config, flat
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.black_box import BlackBox
from robotctl.daemon.recording.head_forwarder import HeadForwarder
from robotctl.daemon.recording.housekeeping import Indexer, Tidier
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.daemon.recording.recordings_folder import DiskReserve, open_recorder, retention_policy
from robotctl.daemon.recording.topic_sinks import TopicSinks
from robotctl.daemon.supervisor import Work
from robotctl.ipc.advice import for_robot
from robotctl.recording import RecorderStats, Topic
from robotctl.recording.format import noted_events
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.seal import Keyring
from robotctl.recording.write.recorder_options import TopicFilter
from robotctl.ros.executor import UNKNOWN_GID
from robotctl.ros.nodes import mode_service, publishers
from robotctl.ros.nodes.publishers import HEAD_TOPIC, JournalPublisher, TextPublisher
from robotctl.ros.session import Session
from robotctl.ros.tap.tap import Tap


def in_loop(call: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a function for any thread, which schedules `call` in the loop that runs now."""
    loop = asyncio.get_running_loop()

    def post(argument: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(call, argument)

    return post


_log = logging.getLogger(__name__)


class FlightRecorder:
    """Records robotctl's own topics from its creation on, others while the tasks of `work` run."""

    def __init__(
        self,
        options: DaemonOptions,
        config: Config,
        session: Session,
        mode: Callable[[], str],
    ) -> None:
        """Start to record. Any thread may call `mode()`, which returns the robot's mode.

        Raises:
            Refused: The recording cannot be written.
        """
        self._robot = options.robot
        self.on_failure: Callable[[str], None] = lambda detail: None
        """Called in the loop when recording has failed, if a failure must stop the robot."""

        self.on_file: Callable[[], None] = lambda: None
        """Called in the loop at each split, to journal a snapshot for the next file."""

        self._closing = False
        self._must_record = config.on_recorder_failure == "stop"
        self._config = config
        publish = (
            TextPublisher(session, HEAD_TOPIC).publish if config.recording.publish_heads else None
        )
        self._heads = HeadForwarder(config.recording.head_command, publish)
        names = mode_service.names(session)
        evidence = {*map(session.resolve, _evidence_topics(config)), *names.values()}
        self._recorder = open_recorder(
            options.recordings,
            options.robot,
            config,
            mode,
            in_loop(self._failed),
            in_loop(self._file_begun),
            in_loop(self._file_full),
            present=lambda: self._config,
            sealer=Keyring(seal_folder(options.robot), options.robot, in_loop(self._heads.take)),
            evidence=frozenset(evidence),
            names={} if options.observe else names,
        )
        topics = (config.kernel.command.topic, config.kernel.odometry.topic)
        own = (mode_service.STATUS.name, publishers.JOURNAL_TOPIC.name)
        proof = map(session.resolve, (*topics, *own))
        topic_filter = TopicFilter(config.recording.include, config.recording.exclude, proof)
        self.sinks = TopicSinks(
            self._recorder,
            config.recording,
            is_own=frozenset(map(session.resolve, _own_topics(config))).__contains__,
            is_evidence=evidence.__contains__,
        )
        self.tap = Tap(session, self.sinks.open, topic_filter.records)
        for own_topic in (publishers.DIAGNOSTICS_TOPIC, publishers.ROSOUT_TOPIC):
            self.tap.subscribe_own(own_topic)
        self._marks = TextPublisher(session, publishers.MARK_TOPIC)
        self._write_mark = self.tap.reserve(publishers.MARK_TOPIC)
        self._events: int | None = None
        """The channel of events for Foxglove, None if they are off."""
        if config.recording.foxglove_events:
            topic = Topic(
                session.resolve(noted_events.TOPIC), noted_events.TYPE_NAME, noted_events.DEFINITION
            )
            self._events = self._recorder.add_topic(topic)
        self.folder = self._recorder.stats().file.parent
        self._black_box = BlackBox(config.recording, self.folder)
        self.tidier = Tidier(retention_policy(config.recording), self.folder)
        self._indexer = Indexer(
            self.folder, log_path(options.robot), enabled=config.recording.index
        )
        self._reserve = DiskReserve(round(config.recording.min_free_gb * 1e9), self.sinks.gates)
        self.report = RecorderReport(self._recorder, topic_filter, options.robot)

    def reconfigure(self, config: Config) -> None:
        """Apply the settings in `config` for retention, clips, index and recorder failures."""
        self._must_record = config.on_recorder_failure == "stop"
        self._black_box.params = config.recording
        self.tidier.policy = retention_policy(config.recording)
        self._indexer.enabled = config.recording.index
        self._config = config

    def work(self) -> dict[str, Work]:
        """Return the tasks of the recorder by name, for the daemon to run."""
        return {
            "recorder": self.tap.run,
            "black box": self._black_box.run,
            "tidier": self.tidier.run,
            "indexer": self._indexer.run,
            "heads of the seal": self._heads.run,
            "topic health": self.sinks.watch,
            "disk reserve": partial(self._reserve.run, self._recorder, self.folder),
        }

    def open_journal(self, publisher: JournalPublisher) -> Callable[[bytes, int], None]:
        """Return `write(serialized, seq)`, which records and publishes a journal entry."""
        write = self.tap.reserve(publishers.JOURNAL_TOPIC)

        def write_entry(serialized: bytes, seq: int) -> None:
            now_ns = time.time_ns()
            write(serialized, now_ns, now_ns, seq + 1, UNKNOWN_GID)
            publisher.publish(serialized)

        return write_entry

    @property
    def failure(self) -> str:
        """Why recording has failed, or ""."""
        return self._recorder.stats().failure

    def note(self, event: RecordedEvent) -> None:
        """Add `event` to the recording's metadata; order a clip of a stop or an error."""
        self._recorder.add_event(event)
        self._black_box.note(event)

    def show_event(self, values: Mapping[str, str]) -> None:
        """Record an event for Foxglove with the present time, if configured."""
        if self._events is not None:
            now_ns = time.time_ns()
            event = noted_events.encode_event(now_ns, now_ns, values)
            self._recorder.write(self._events, event, now_ns, now_ns, 0, UNKNOWN_GID)

    def mark(self, text: str, source: str) -> RecordedEvent:
        """Add a mark with the present time to the recording, and publish it."""
        now_ns = time.time_ns()
        event = RecordedEvent(EventKind.MARK, now_ns, f"{text} [{source}]")
        self._write_mark(self._marks.publish(event.text), now_ns, now_ns, 0, UNKNOWN_GID)
        self.note(event)
        self.show_event({"event": "mark", "text": text, "by": source})
        _log.info("marked: %s", event.text)
        return event

    def split(self) -> None:
        """Start the next file without a gap, and return before it is open."""
        self._recorder.split()
        self.on_file()

    def stats(self) -> RecorderStats:
        """Return the message counts so far."""
        return self._recorder.stats()

    def received(self) -> dict[str, int]:
        """Return the number of received messages of each topic."""
        counts: Counter[str] = Counter()
        for topic in self._recorder.stats().topics:
            counts[topic.name] += topic.received
        return counts

    async def close(self) -> None:
        """Close the recording, send the seal's last head, cut clips and start the indexing."""
        self._closing = True
        stats = await asyncio.to_thread(self._recorder.close)
        _log.info(
            "recorded %d messages in %s, %d dropped, %d lost",
            stats.written,
            stats.file,
            stats.dropped,
            stats.lost,
        )
        await self._heads.finish()
        await self._black_box.finish()
        await self._indexer.finish()

    async def discard(self) -> None:
        """Remove the recording of a start that failed."""
        stats = await asyncio.to_thread(self._recorder.close)
        await asyncio.to_thread(rmtree, stats.file.parent, ignore_errors=True)

    def problems(self) -> list[str]:
        """Return the warnings of the recorder's parts, one sentence each."""
        return [
            *self.tap.unrecorded.warnings(),
            *self.tap.mismatches.warnings(),
            *(warning for _, warning in self.report.heavy_warnings()),
            *self._reserve.warnings(),
            *self.sinks.health.warnings(time.monotonic()),
            *self.tidier.problems,
            *filter(None, [self._heads.problem, self._indexer.problem]),
        ]

    def _failed(self, detail: str) -> None:
        _log.error("%s", for_robot(detail, self._robot))
        if self._must_record:
            self.on_failure(detail)

    def _file_full(self, _: Path) -> None:
        if not self._closing:
            self.split()

    def _file_begun(self, path: Path) -> None:
        _log.info("recording continues in %s", path)
        self.tidier.finished.set()
        self._indexer.file_finished()


_EVIDENCE = (
    *(publishers.JOURNAL_TOPIC, mode_service.STATUS, publishers.MARK_TOPIC),
    *mode_service.CALLS,
)
"""The daemon's own topics that a check of the decisions needs."""


def _own_topics(config: Config) -> list[str]:
    others = (publishers.DIAGNOSTICS_TOPIC, publishers.ROSOUT_TOPIC, HEAD_TOPIC)
    return [config.kernel.command.topic, *(topic.name for topic in (*_EVIDENCE, *others))]


def _evidence_topics(config: Config) -> list[str]:
    """Return the topics that a check of the decisions needs."""
    used = [str(name) for key, name in flat(config).items() if key.endswith("topic") and name]
    return [*used, *(topic.name for topic in _EVIDENCE)]
