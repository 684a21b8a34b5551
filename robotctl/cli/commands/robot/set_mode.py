"""set-mode: options and help; `cli.quick.set_mode` implements it."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Reason, Robot, new_app

app = new_app()


@app.command("set-mode")
def set_mode(
    mode: Annotated[
        str,
        typer.Argument(metavar="MODE", help=f"{quick.VALID_MODES}; names in any case."),
    ],
    reason: Reason = "",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Ask for a mode; `moving` drives the configured pattern.

    A refusal names the condition that does not hold and exits with code 4.

    \b
    Examples:
      robotctl set-mode moving
      robotctl set-mode EMERGENCY_STOP
      robotctl set-mode 0
    """
    quick.set_mode(mode, robot, as_json, reason)
