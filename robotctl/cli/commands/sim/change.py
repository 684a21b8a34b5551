"""sim set: another state of the simulated robot."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.cli.commands.sim.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.quick_actions import request_source
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
from robotctl.ipc.client import call
from robotctl.ipc.method_names import SIM_SET
from robotctl.paths import DEFAULT_ROBOT

KEY = "battery"


@group.command("set")
def change(
    setting: Annotated[str, typer.Argument(metavar="battery=LEVEL", help="0 to 1.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Set the battery level of the robot that the daemon simulates.

    \b
    Examples:
      robotctl sim set battery=0.1
    """
    answer = call(robot, SIM_SET, {KEY: _level(setting), "source": request_source("sim set")})
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


def _level(setting: str) -> float:
    key, _, text = setting.partition("=")
    try:
        level = float(text) if key == KEY else -1.0
    except ValueError:
        level = -1.0
    if not 0.0 <= level <= 1.0:
        raise UsageError(f"{printable(setting)}", "use battery=0 to battery=1")
    return level
