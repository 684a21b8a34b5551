"""stop: options and help; `quick_actions.stop` implements it."""

from __future__ import annotations

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support import quick_actions
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


@app.command()
def stop(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the robot, close the recording and end the daemon.

    Returns when the process has ended.

    \b
    Examples:
      robotctl stop
    """
    quick_actions.stop(robot, as_json)
