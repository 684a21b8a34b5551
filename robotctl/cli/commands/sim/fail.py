"""sim fault: let the simulated robot fail, and see it stop."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from robotctl.cli.commands.sim.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.quick_actions import request_source
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
from robotctl.ipc.client import call
from robotctl.ipc.method_names import SIM_FAULT
from robotctl.paths import DEFAULT_ROBOT
from robotctl.sim.faults import MAX_FAULT_S, SimFault

_NAMES = ", ".join(fault.value for fault in SimFault)
_UNITS = (("ms", 1e-3), ("s", 1.0), ("", 1.0))


@group.command("fault")
def fail(
    fault: Annotated[SimFault, typer.Argument(metavar="FAULT", help=f"One of {_NAMES}.")],
    duration: Annotated[
        str, typer.Option("--for", metavar="TIME", help="How long, such as 2s or 500ms.")
    ] = "2s",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Let the robot that the daemon simulates fail for a while, and tell when it stopped.

    The milliseconds go from the fault to the mode that commands zero.

    \b
    Examples:
      robotctl sim fault odom-lost --for 2s
      robotctl sim fault slip --for 5s
    """
    params = {
        "fault": fault.value,
        "for_s": seconds(duration),
        "source": request_source("sim fault"),
    }
    answer = call(robot, SIM_FAULT, params, deadline_s=None)
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


def seconds(text: str) -> float:
    """Return a duration in seconds.

    Raises:
        UsageError: It is none, or too long.
    """
    unit, factor = next((unit, factor) for unit, factor in _UNITS if text.endswith(unit))
    try:
        found = float(text.removesuffix(unit)) * factor
    except ValueError:
        found = math.nan
    if not 0.0 < found <= MAX_FAULT_S:
        raise UsageError(f"--for {printable(text)}", f"use 1ms to {MAX_FAULT_S:g}s")
    return found
