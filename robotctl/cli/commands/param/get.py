"""param get: the value of one parameter."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.cli.commands.param.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST
from robotctl.paths import DEFAULT_ROBOT


@group.command()
def get(
    key: Annotated[str, typer.Argument(metavar="KEY", help="Such as limits.linear_mps.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Show the value of one parameter; --json shows its whole declaration.

    \b
    Examples:
      robotctl param get limits.linear_mps
    """
    known = {each["key"]: each for each in call(robot, PARAM_LIST)["parameters"]}
    if key not in known:
        from difflib import get_close_matches

        near = get_close_matches(key, known, n=1)
        cure = f"did you mean {near[0]}?" if near else "robotctl param list shows all of them"
        raise UsageError(f"{printable(key)}: no such key", cure)
    print_answer(known[key], [printable(known[key]["value"])], as_json=as_json)
