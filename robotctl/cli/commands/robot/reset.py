"""reset: options and help; `cli.quick.reset` implements it."""

from __future__ import annotations

from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Reason, Robot, new_app

app = new_app()


@app.command()
def reset(reason: Reason = "", robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Release EMERGENCY_STOP or ERROR to IDLE; nothing moves yet.

    Refused, with exit code 4, while the cause persists.

    \b
    Examples:
      robotctl reset
    """
    quick.reset(robot, as_json, reason)
