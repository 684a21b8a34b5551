"""estop: options and help; `cli.quick.estop` implements it."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Reason, Robot, new_app

app = new_app()


@app.command()
def estop(
    reason: Reason = "",
    every: Annotated[bool, typer.Option("--all", help="Stop every robot of this user.")] = False,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Stop at once and latch EMERGENCY_STOP.

    This is a software stop, not a safety-rated one. It stays latched over restarts and reboots,
    until robotctl reset. It names the other robots that still move.

    \b
    Examples:
      robotctl estop
      robotctl estop --robot r2 --reason "a child ran in"
      robotctl estop --all
    """
    quick.estop(robot, as_json, reason, every)
