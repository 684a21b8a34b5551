"""status: options and help; `cli.quick.status` implements it."""

from __future__ import annotations

from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Robot, new_app

app = new_app()


@app.command()
def status(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show mode, pose, battery, recorder and topics on one screen.

    \b
    Examples:
      robotctl status
      robotctl status --json | jq .mode
    """
    quick.status(robot, as_json)
