"""The input (Host), tasks and diagnostics of both daemons, driver and observer."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Final

from robotctl.config import Config
from robotctl.daemon.api.warnings import PartWarning, Warnings
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.daemon.supervisor import Supervisor, Work
from robotctl.decisions.log import DecisionLog
from robotctl.ipc.answers import StartSummary
from robotctl.ros.nodes.publishers import Diagnosis, DiagnosticLevel, DiagnosticsPublisher
from robotctl.ros.session import Session

Ready = Callable[[StartSummary], None]
"""Called once with the summary of a daemon that is ready."""


@dataclass(frozen=True, slots=True)
class Host:
    """The options, the ROS session and the other objects from which a daemon is built."""

    options: DaemonOptions
    config: Config
    alone: bool
    """Whether the ROS domain certainly had no other participant at the start."""

    supervisor: Supervisor
    discovered_by_s: float
    """Steady time [s] at which a start stops waiting for other nodes."""

    stop: asyncio.Event
    """Set to end the daemon."""

    session: Session
    decisions: DecisionLog

    warnings: list[PartWarning]
    """Functions that return a warning for `status`, from each part of the daemon."""


@asynccontextmanager
async def running(supervisor: Supervisor, work: Mapping[str, Work]) -> AsyncIterator[None]:
    """Run the tasks under the supervisor, and cancel them at the end of the block."""
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(supervisor.run(name, each)) for name, each in work.items()]
        yield
        for task in tasks:
            task.cancel()


PERIOD_S: Final = 1.0

MAX_WARNINGS: Final = 100
"""Limit on the warnings in a diagnosis."""


class Diagnostics:
    """Samples the message rates, and publishes diagnoses of recorder and daemon, once a second."""

    def __init__(
        self, session: Session, robot: str, recorder: RecorderReport, warnings: Warnings
    ) -> None:
        self._publisher = DiagnosticsPublisher(session, robot)
        self._recorder = recorder
        self._warnings = warnings

    async def run(self) -> None:
        """Sample the rates and publish both diagnoses once a second, until cancelled."""
        while True:
            self._recorder.sample(self._recorder.stats())
            self.publish()
            await asyncio.sleep(PERIOD_S)

    def publish(self) -> None:
        """Publish the diagnoses of recorder and daemon now."""
        stats = self._recorder.stats()
        of_recording = self._warnings.of_recording(stats)
        self._publisher.publish(
            self._recorder.diagnosis(stats, of_recording), diagnose(self._warnings.now(stats))
        )


def diagnose(warnings: Sequence[str]) -> Diagnosis:
    """Return the daemon's warnings as a diagnosis for /diagnostics."""
    values = {f"warning {n}": text for n, text in enumerate(warnings[:MAX_WARNINGS], start=1)}
    if not warnings:
        return Diagnosis("daemon", DiagnosticLevel.OK, "no warnings", values)
    others = f" (and {len(warnings) - 1} more)" if len(warnings) > 1 else ""
    return Diagnosis("daemon", DiagnosticLevel.WARN, f"{warnings[0]}{others}", values)
