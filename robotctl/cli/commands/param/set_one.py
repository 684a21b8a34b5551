"""param set: change one parameter of the running daemon."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.cli.commands.param.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.quick_actions import request_source
from robotctl.cli.terminal.text import printable
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_SET
from robotctl.paths import DEFAULT_ROBOT


@group.command("set", context_settings={"ignore_unknown_options": True})
def set_one(
    key: Annotated[str, typer.Argument(metavar="KEY", help="Such as limits.linear_mps.")],
    value: Annotated[str, typer.Argument(metavar="VALUE", help="Its new value.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Change one parameter of the daemon, until the daemon ends.

    The change is recorded, and `replay --check` decides with it. Most parameters change only while
    the robot stands; some only at a start. `robotctl param list` says which.

    \b
    Examples:
      robotctl param set limits.linear_mps 0.4
      robotctl param set pattern.kind circle
    """
    answer = call(
        robot, PARAM_SET, {"key": key, "value": value, "source": request_source("param set")}
    )
    line = f"{key}: {printable(answer['old'])} -> {printable(answer['new'])}"
    print_answer(answer, [line], as_json=as_json)
