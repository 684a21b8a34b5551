"""status, set-mode, estop and reset, declared for typer; `control` carries them out."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.cli import control
from robotctl.cli.options import Json, Robot, new_app
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


@app.command()
def status(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show mode, pose, battery, recorder and topics on one screen.

    \b
    Examples:
      robotctl status
      robotctl status --json | jq .mode
    """
    control.status(robot, as_json)


@app.command("set-mode")
def set_mode(
    mode: Annotated[
        str,
        typer.Argument(
            metavar="MODE", help="idle, moving, error or emergency-stop, in any case, or 0 to 3."
        ),
    ],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Ask for a mode; `moving` drives the configured pattern.

    A refusal names the condition that does not hold, and exits with 4.

    \b
    Examples:
      robotctl set-mode moving
      robotctl set-mode EMERGENCY_STOP
      robotctl set-mode 0
    """
    control.set_mode(mode, robot, as_json)


@app.command()
def estop(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop at once and latch EMERGENCY_STOP.

    A software stop, not a safety-rated one. It outlives the daemon and a reboot, until
    robotctl reset.

    \b
    Examples:
      robotctl estop
      robotctl estop --robot r2
    """
    control.estop(robot, as_json)


@app.command()
def reset(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Release EMERGENCY_STOP or ERROR to IDLE; nothing moves yet.

    Refused, with exit code 4, as long as the cause is there.

    \b
    Examples:
      robotctl reset
    """
    control.reset(robot, as_json)
