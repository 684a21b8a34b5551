"""stop: the robot stands, the recording is closed, the daemon ends."""

from __future__ import annotations

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support import control
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


@app.command()
def stop(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the robot, close the recording and end the daemon.

    Returns when the process is gone.

    \b
    Examples:
      robotctl stop
    """
    control.stop(robot, as_json)
