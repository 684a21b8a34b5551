"""stop: options and help; `cli.quick.stop` implements it."""

from __future__ import annotations

from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Robot, new_app

app = new_app()


@app.command()
def stop(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the robot, close the recording and end the daemon.

    Returns when the process has ended.

    \b
    Examples:
      robotctl stop
    """
    quick.stop(robot, as_json)
