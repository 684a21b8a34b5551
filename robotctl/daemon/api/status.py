"""The methods that every daemon offers for its status, its stop and the ROS graph."""

from __future__ import annotations

import asyncio
import os
import time
from typing import Any, Protocol, cast

from robotctl import __version__
from robotctl.base.domains import discovery_range
from robotctl.base.errors import UsageError
from robotctl.base.paths import log_path, socket_path
from robotctl.daemon.api.warnings import Warnings
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.ipc.advice import advice, for_robot
from robotctl.ipc.answers import (
    Graph,
    GraphNode,
    GraphTopic,
    MessageAnswer,
    RobotFacts,
    StartSummary,
    Status,
)
from robotctl.ipc.method_names import GRAPH, GRAPH_NODE, GRAPH_TOPIC, STATUS, STOP
from robotctl.ipc.method_params import GraphNameParams, NoParams
from robotctl.ipc.request_handler import Method
from robotctl.kernel.remedies import Remedy
from robotctl.recording import RecorderStats
from robotctl.ros.graph.overview import node_facts, overview, topic_facts
from robotctl.ros.tap.tap import Tap


def graph_methods(tap: Tap) -> dict[str, Method[Any]]:
    """Return `graph`, `graph_topic` and `graph_node`; they only read rcl's graph cache."""

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


class RobotView(Protocol):
    """Makes the robot's part of the status, in a driver or an observer."""

    def facts(self) -> RobotFacts:
        """Return the robot's part of the status."""

    def remedies(self) -> tuple[Remedy, ...]:
        """Return what the operator can do to leave the present mode."""


class StatusSource:
    """Makes status and start summary; `scheduling` is how Linux schedules the loop's thread."""

    def __init__(
        self,
        options: DaemonOptions,
        recording: RecorderReport,
        robot: RobotView,
        scheduling: str,
        warnings: Warnings,
    ) -> None:
        self._options = options
        self._recording = recording
        self._robot = robot
        self._scheduling = scheduling
        self._warnings = warnings
        self._socket = str(socket_path(options.robot))
        self._discovery_range = discovery_range()
        self._started = time.monotonic()

    def stats(self) -> RecorderStats:
        """Return the recorder's current counts, for `status`."""
        return self._recording.stats()

    def status(self, stats: RecorderStats) -> Status:
        """Return the object of `robotctl status --json`; `stats` are the recorder's counts."""
        robot, facts = self._options.robot, self._robot.facts()
        if facts["mode_reason"]:
            told = advice(facts["mode_reason"], self._robot.remedies(), robot)
            facts["mode_reason"] = told.sentence
        return {
            "robot": robot,
            "version": __version__,
            "pid": os.getpid(),
            **facts,
            **self._recording.facts(stats),
            "warnings": self._warnings.now(stats),
            "namespace": self._options.namespace,
            "domain_id": self._options.domain_id,
            "discovery_range": self._discovery_range,
            "scheduling": self._scheduling,
            "socket": self._socket,
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def summary(self, notes: list[str]) -> StartSummary:
        """Return what a ready daemon reports to the process that started it, `notes` included."""
        status = self.status(self.stats())
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
    """Return the methods `status` and `stop`; the method `stop` sets the event `stop`."""

    async def get_status(_: NoParams) -> Status:
        stats = status.stats()
        await asyncio.sleep(0)  # with 500 changing topics, each of the two steps takes 0.3 ms
        return status.status(stats)

    async def end(_: NoParams) -> MessageAnswer:
        stop.set()
        return {"message": f"Stopped: {status.stats().file}"}

    return {STATUS: Method(NoParams, get_status), STOP: Method(NoParams, end)}
