"""What the app gives to each kind of daemon, and what each kind must offer."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from robotctl.config import Config
from robotctl.daemon.api.status import PartWarning
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.supervisor import Supervisor, Work
from robotctl.decisions.log import DecisionLog
from robotctl.ipc.answers import StartSummary
from robotctl.ipc.request_handler import Method
from robotctl.ipc.server import ControlServer
from robotctl.ros.session import Session

Ready = Callable[[StartSummary], None]
"""Called once with the summary of a daemon that is ready."""


@dataclass(frozen=True, slots=True)
class Host:
    """The environment that a daemon is made in."""

    options: DaemonOptions
    config: Config
    alone: bool
    """Whether no other process was in the ROS domain at the start."""

    supervisor: Supervisor
    discovered_by_s: float
    """The steady time [s] until which a start waits for a robot before it simulates one."""

    stop: asyncio.Event
    """Set to end the daemon."""

    session: Session
    decisions: DecisionLog

    warnings: list[PartWarning]
    """Called at each `status`; a part of the daemon appends its warning here."""


class DaemonKind(Protocol):
    """A kind of daemon: Driver or Observer. It publishes nothing before the recorder runs."""

    recorder: FlightRecorder

    def methods(self) -> Mapping[str, Method[Any]]:
        """Return the methods of the control socket."""

    async def run(self, server: ControlServer, notes: list[str], on_ready: Ready) -> None:
        """Run every task until the daemon is stopped."""

    def mode(self) -> str:
        """Return what the daemon does now, in a word."""

    async def stop_robot(self) -> None:
        """Stop the robot at once: the daemon is about to fail."""


@asynccontextmanager
async def running(supervisor: Supervisor, work: Mapping[str, Work]) -> AsyncIterator[None]:
    """Run the tasks under the supervisor until the end of the block."""
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(supervisor.run(name, each)) for name, each in work.items()]
        yield
        for task in tasks:
            task.cancel()
