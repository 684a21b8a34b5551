"""The owner of the mode where each role is a process: a daemon that commands a gate."""

from __future__ import annotations

import time
from collections.abc import Coroutine
from dataclasses import replace
from typing import Any

from robotctl.daemon.control.inputs import watch_graph
from robotctl.daemon.driver import Driver
from robotctl.daemon.host import Host
from robotctl.kernel.checks import stands_alone
from robotctl.kernel.types import Cause, FaultCleared, FaultReported
from robotctl.ros.messages.command_type import PLAIN, CommandType
from robotctl.ros.nodes.owner_velocity import OwnerVelocity


class Owner(Driver):
    """A driver whose commands pass a gate, the process of node `velocity_publisher`.

    A motion needs exactly one gate, and a robot behind it. Without either, a standalone owner
    grants MOVING and commands zeros.
    """

    _ending = "Shutting down ..."

    def __init__(self, host: Host, command: CommandType) -> None:
        """Command by messages of this type; the gate takes and passes on the same."""
        self._gate_problem = ""
        self._gated: OwnerVelocity
        super().__init__(host, replace(command, qos=PLAIN.qos))

    def _make_velocity(self) -> OwnerVelocity:
        self._gated = OwnerVelocity(
            self._host.session,
            self._host.config.kernel.command.topic,
            self._command,
            lambda: self._control.state.silent,
        )
        return self._gated

    def _graph_watch(self) -> Coroutine[Any, Any, None]:
        return watch_graph(self._gated, self._odometry, self._control.dispatch, self._look_at_gate)

    def _look_at_gate(self) -> None:
        health, params = self._control.state.health, self._control.params
        problem = "" if stands_alone(health, params) else self._gated.gate_problem()
        if problem == self._gate_problem:
            return
        self._gate_problem = problem
        now, cause = time.monotonic_ns(), Cause.GATE_LOST
        self._control.dispatch(
            FaultReported(now, cause, problem) if problem else FaultCleared(now, cause)
        )
