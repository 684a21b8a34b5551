"""The methods of the control socket that make the simulated robot fail."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from robotctl.base.errors import Refused, UsageError
from robotctl.daemon.control.dispatcher import Control
from robotctl.ipc.answers import MessageAnswer, SimFaulted
from robotctl.ipc.method_names import SIM_FAULT, SIM_SET
from robotctl.ipc.method_params import SimFaultParams, SimSetParams
from robotctl.ipc.server import Method
from robotctl.kernel.modes import Mode
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.sim import SimFault

POLL_S = 0.001

AFTER_S = 1.0
"""How long `sim_fault` waits after the end of a fault to see whether the robot stops."""


def simulation_methods(
    simulated: Callable[[], SimulatedRobot | None],
    control: Control,
    mark: Callable[[str, str], object],
) -> dict[str, Method[Any]]:
    """Return methods `sim_set` and `sim_fault` by name; `mark(text, source)` records each use."""

    def robot() -> SimulatedRobot:
        found = simulated()
        if found is None:
            raise Refused("this daemon simulates no robot", "start it with: robotctl start --sim")
        return found

    async def set_battery(params: SimSetParams) -> MessageAnswer:
        wanted = robot()
        mark(f"simulated battery: {params.battery:g}", params.source)
        wanted.set_battery(params.battery)
        return {"message": f"The simulated battery is at {params.battery:.0%}"}

    async def fault(params: SimFaultParams) -> SimFaulted:
        wanted, kind = robot(), _fault(params.fault)
        moved = control.state.mode is Mode.MOVING
        mark(f"simulated fault: {kind.value} for {params.for_s:g} s", params.source)
        began_s = time.monotonic()
        wanted.begin_fault(kind, params.for_s)
        while moved and control.state.mode is Mode.MOVING:
            if time.monotonic() - began_s > params.for_s + AFTER_S:
                break
            await asyncio.sleep(POLL_S)
        after_ms = (time.monotonic() - began_s) * 1e3
        state = control.state
        stopped = moved and state.mode is not Mode.MOVING
        told = (
            f"{state.mode.name} after {after_ms:.0f} ms: {state.reason}"
            if stopped
            else ("the robot moves on" if moved else "the robot did not move")
        )
        return {
            "message": f"{kind.value} for {params.for_s:g} s: {told}",
            "mode": state.mode.name,
            "stopped_after_ms": after_ms if stopped else None,
        }

    return {
        SIM_SET: Method(SimSetParams, set_battery),
        SIM_FAULT: Method(SimFaultParams, fault, None),
    }


def _fault(name: str) -> SimFault:
    try:
        return SimFault(name)
    except ValueError:
        names = ", ".join(fault.value for fault in SimFault)
        raise UsageError(f"no simulated fault {name!r}", f"use {names}") from None
