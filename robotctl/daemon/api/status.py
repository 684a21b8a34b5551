"""The answer of `status`, collected from every part of the daemon."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from robotctl import __version__
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.domains import discovery_range, wider_discovery
from robotctl.ipc.advice import advice, for_robot
from robotctl.ipc.answers import RobotFacts, StartSummary, Status
from robotctl.kernel.remedies import Remedy
from robotctl.paths import log_path, socket_path
from robotctl.recording import RecorderStats

PartWarning = Callable[[], str]
"""Returns what is wrong with a part of the daemon as a sentence, else ""."""


class RobotView(Protocol):
    """The state of the robot."""

    def facts(self) -> RobotFacts:
        """Return the robot's part of the status."""

    def remedies(self) -> tuple[Remedy, ...]:
        """Return what the operator can do about the mode."""

    def warnings(self) -> Iterator[str]:
        """Yield what is wrong, one sentence each."""


class StatusSource:
    """The source of the status; `scheduling` is the Linux scheduling of the loop's thread."""

    def __init__(
        self,
        options: DaemonOptions,
        recording: RecorderReport,
        robot: RobotView,
        scheduling: str,
        parts: Iterable[PartWarning],
    ) -> None:
        self._options = options
        self._recording = recording
        self._robot = robot
        self._scheduling = scheduling
        self._parts = parts
        self._socket = str(socket_path(options.robot))
        self._discovery_range, self._wider_discovery = discovery_range(), wider_discovery()
        self._started = time.monotonic()

    def stats(self) -> RecorderStats:
        """Return the recorder's counts of now, for the other methods."""
        return self._recording.stats()

    def status(self, stats: RecorderStats) -> Status:
        """Return the object of `robotctl status --json`, with these counts."""
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
            "warnings": self.warnings(stats),
            "namespace": self._options.namespace,
            "domain_id": self._options.domain_id,
            "discovery_range": self._discovery_range,
            "scheduling": self._scheduling,
            "socket": self._socket,
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def warnings(self, stats: RecorderStats) -> list[str]:
        """Return what is wrong, or may be, one sentence each; `stats` are those of the recorder."""
        return [for_robot(warning, self._options.robot) for warning in self._warnings(stats)]

    def summary(self, notes: list[str]) -> StartSummary:
        """Return the report of a ready daemon to its starter."""
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

    def _warnings(self, stats: RecorderStats) -> Iterator[str]:
        yield from self._recording.warnings(stats)
        yield from self._robot.warnings()
        yield from filter(None, (part() for part in self._parts))
        if self._wider_discovery:
            yield f"ROS discovery is not limited to this machine: {self._wider_discovery}"
