"""The daemon that only records, while other software drives."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, NoReturn

from robotctl.base.errors import Refused
from robotctl.daemon.api.status import (
    StatusSource,
    common_methods,
    graph_methods,
    recording_methods,
)
from robotctl.daemon.api.warnings import Warnings
from robotctl.daemon.host import Diagnostics, Host, Ready, running
from robotctl.daemon.parameters import list_method
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.ipc.method_names import OF_A_ROBOT
from robotctl.ipc.method_params import AnyParams
from robotctl.ipc.server import ControlServer, Method
from robotctl.kernel.types import Event, FaultReported
from robotctl.recording.format.names import OBSERVING

_log = logging.getLogger(__name__)


class Observer:
    """Records, and serves the control socket, without a kernel and a robot."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._faults: dict[str, None] = {}
        self.recorder = FlightRecorder(
            host.options,
            host.config,
            host.session,
            lambda: OBSERVING,
        )
        warnings = Warnings(host.options.robot, self.recorder, None, host.warnings, self._faults)
        self._status = StatusSource(
            host.options, self.recorder.report, None, host.session.executor.scheduling, warnings
        )
        self._diagnostics = Diagnostics(
            host.session, host.options.robot, self.recorder.report, warnings
        )
        self.recorder.sinks.on_news = self._diagnostics.publish
        host.supervisor.report_to(self._note)

    def methods(self) -> Mapping[str, Method[Any]]:
        """Return the control socket's methods by name. Those that need a robot refuse each call."""
        return {
            **common_methods(self._status, self._host.stop),
            **recording_methods(self.recorder, self._host.options.robot),
            **list_method(lambda: self._host.config),
            **graph_methods(self.recorder.tap),
            **dict.fromkeys(OF_A_ROBOT, Method(AnyParams, self._refuse)),
        }

    async def run(self, server: ControlServer, notes: list[str], on_ready: Ready) -> None:
        """Record until the daemon is stopped."""
        work = {
            **self.recorder.work(),
            "diagnostics": self._diagnostics.run,
            "socket": server.serve,
        }
        async with running(self._host.supervisor, work):
            on_ready(self._status.summary(notes))
            _log.info("ready: observing")
            await self._host.stop.wait()
            _log.info("stopping")

    def mode(self) -> str:
        """Return "observing" in place of a robot's mode."""
        return OBSERVING

    async def stop_robot(self) -> None:
        """Do nothing, as there is no robot to stop."""

    def _note(self, event: Event) -> None:
        if isinstance(event, FaultReported):
            self._faults[event.detail] = None

    async def _refuse(self, _: object) -> NoReturn:
        raise Refused(
            f"robot {self._host.options.robot!r} is only observed (robotctl start --observe): "
            "nothing was sent to it; use the stop of the stack that drives it"
        )
