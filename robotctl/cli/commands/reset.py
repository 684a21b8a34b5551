"""reset: release the emergency stop or an error. `control` carries it out."""

from __future__ import annotations

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support import control
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


@app.command()
def reset(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Release EMERGENCY_STOP or ERROR to IDLE; nothing moves yet.

    Refused, with exit code 4, as long as the cause is there.

    \b
    Examples:
      robotctl reset
    """
    control.reset(robot, as_json)
