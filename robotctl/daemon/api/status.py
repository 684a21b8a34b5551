"""The methods of every daemon, for its status, its stop, the ROS graph and the recording."""

from __future__ import annotations

import asyncio
import os
import time
from typing import Any, cast

from robotctl import __version__
from robotctl.base.domains import discovery_range
from robotctl.base.errors import Refused, UsageError
from robotctl.base.paths import log_path, socket_path
from robotctl.daemon.api.warnings import Warnings, of_recording
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.daemon.supervisor import until
from robotctl.ipc.advice import advice, for_robot
from robotctl.ipc.answers import (
    Committed,
    FileSplit,
    Graph,
    GraphNode,
    GraphTopic,
    Marked,
    MessageAnswer,
    RecordStatus,
    RobotFacts,
    StartSummary,
    Status,
)
from robotctl.ipc.method_names import (
    GRAPH,
    GRAPH_NODE,
    GRAPH_TOPIC,
    MARK,
    RECORD_COMMIT,
    RECORD_SPLIT,
    RECORD_STATUS,
    STATUS,
    STOP,
)
from robotctl.ipc.method_params import GraphNameParams, MarkParams, NoParams
from robotctl.ipc.server import Method
from robotctl.recording import RecorderStats
from robotctl.ros.graph.endpoints import node_facts, overview, topic_facts
from robotctl.ros.tap.tap import Tap


def graph_methods(tap: Tap) -> dict[str, Method[Any]]:
    """Return the methods `graph`, `graph_topic` and `graph_node` by name."""

    async def graph(_: NoParams) -> Graph:
        return cast(Graph, overview(tap.node))

    async def topic(params: GraphNameParams) -> GraphTopic:
        return cast(GraphTopic, topic_facts(tap.node, params.name))

    async def node(params: GraphNameParams) -> GraphNode:
        found = node_facts(tap.node, params.name)
        if found is None:
            raise UsageError(f"no node {params.name!r}")
        return cast(GraphNode, found)

    return {
        GRAPH: Method(NoParams, graph),
        GRAPH_TOPIC: Method(GraphNameParams, topic),
        GRAPH_NODE: Method(GraphNameParams, node),
    }


class StatusSource:
    """Makes the answer of `status` and the summary that a ready daemon reports."""

    def __init__(
        self,
        options: DaemonOptions,
        recording: RecorderReport,
        robot: RobotReport | None,
        scheduling: str,
        warnings: Warnings,
    ) -> None:
        """`scheduling` is the policy of the loop's thread. In an observer, `robot` is None."""
        self._options = options
        self.recording = recording
        self._robot = robot
        self._scheduling = scheduling
        self._warnings = warnings
        self._socket = str(socket_path(options.robot))
        self._discovery_range = discovery_range()
        self._started = time.monotonic()

    def status(self, stats: RecorderStats) -> Status:
        """Return what `robotctl status --json` prints; `stats` is the recorder's counts."""
        robot, report = self._options.robot, self._robot
        unknown = cast(RobotFacts, dict.fromkeys(RobotFacts.__annotations__))
        facts = unknown if report is None else report.facts()
        if report is not None and facts["mode_reason"]:
            facts["mode_reason"] = advice(facts["mode_reason"], report.remedies(), robot).sentence
        return {
            "robot": robot,
            "version": __version__,
            "pid": os.getpid(),
            **facts,
            **self.recording.facts(stats),
            "warnings": self._warnings.now(stats),
            "namespace": self._options.namespace,
            "domain_id": self._options.domain_id,
            "discovery_range": self._discovery_range,
            "scheduling": self._scheduling,
            "socket": self._socket,
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def summary(self, notes: list[str]) -> StartSummary:
        """Return what a ready daemon reports to the process that started it, with `notes`."""
        status = self.status(self.recording.stats())
        return {
            "ready": True,
            "robot": status["robot"],
            "mode": status["mode"],
            "domain_id": status["domain_id"],
            "discovery_range": status["discovery_range"],
            "sim": status["sim"],
            "socket": status["socket"],
            "pid": status["pid"],
            "recording": status["recorder"]["file"],
            "log": str(log_path(self._options.robot)),
            "notes": [for_robot(note, self._options.robot) for note in notes],
        }


def common_methods(status: StatusSource, stop: asyncio.Event) -> dict[str, Method[Any]]:
    """Return the methods `status` and `stop` by name. The method `stop` sets the event `stop`."""

    async def get_status(_: NoParams) -> Status:
        stats = status.recording.stats()
        await asyncio.sleep(0)  # with 500 changing topics, each of the two steps takes 0.3 ms
        return status.status(stats)

    async def end(_: NoParams) -> MessageAnswer:
        stop.set()
        return {"message": f"Stopped: {status.recording.stats().file}"}

    return {STATUS: Method(NoParams, get_status), STOP: Method(NoParams, end)}


SPLIT_DEADLINE_S = 5.0
"""How long the disk may take to finish one file and start the next."""

COMMIT_DEADLINE_S = 5.0
"""How long `record_commit` waits for the disk."""


def recording_methods(recorder: FlightRecorder, robot: str) -> dict[str, Method[Any]]:
    """Return the methods `record_*` and `mark` by name."""

    def failure() -> str:
        return for_robot(recorder.failure, robot)

    async def status(_: NoParams) -> RecordStatus:
        stats = recorder.stats()
        return {
            **recorder.report.facts(stats),
            "warnings": [for_robot(text, robot) for text in of_recording(recorder, stats)],
        }

    async def commit(_: NoParams) -> Committed:
        """Answer when the file has all messages received so far, or after COMMIT_DEADLINE_S."""
        received = recorder.stats().received

        def uncommitted() -> int:
            stats = recorder.stats()
            return max(received - stats.written - stats.dropped, 0)

        await until(lambda: bool(recorder.failure) or not uncommitted(), COMMIT_DEADLINE_S)
        return {
            "file": _file_of(recorder),
            "uncommitted": uncommitted(),
            "failure": failure(),
        }

    async def split(_: NoParams) -> FileSplit:
        before = _file_of(recorder)
        recorder.split()
        if not await until(
            lambda: bool(recorder.failure) or _file_of(recorder) != before, SPLIT_DEADLINE_S
        ):
            raise Refused("the disk is too slow: the next file starts as soon as it can")
        if recorder.failure:
            raise Refused(failure())
        file = _file_of(recorder)
        return {"message": f"Recording continues in {file}", "finished": before, "file": file}

    async def mark(params: MarkParams) -> Marked:
        if recorder.failure:
            raise Refused(failure())
        event = recorder.mark(params.text, params.source)
        return {"message": "Marked", "text": params.text, "time_ns": event.log_ns}

    return {
        RECORD_STATUS: Method(NoParams, status),
        RECORD_COMMIT: Method(NoParams, commit),
        RECORD_SPLIT: Method(NoParams, split, 2 * SPLIT_DEADLINE_S),
        MARK: Method(MarkParams, mark),
    }


def _file_of(recorder: FlightRecorder) -> str:
    return str(recorder.stats().file)
