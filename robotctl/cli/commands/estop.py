"""estop: stop at once and latch. `control` carries it out."""

from __future__ import annotations

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support import control
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


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
