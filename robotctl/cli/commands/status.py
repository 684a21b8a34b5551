"""status: one screen about the daemon and its robot. `control` carries it out."""

from __future__ import annotations

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support import control
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
