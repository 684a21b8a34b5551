"""param: list, read and change the parameters of a running daemon."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import column_width, printable
from robotctl.ipc.answers import ParameterList
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST, PARAM_SET

app = new_app()
group = new_app()
app.add_typer(group, name="param")


@group.callback()
def param() -> None:
    """List, read and change the parameters of the daemon.

    \b
    Examples:
      robotctl param list
      robotctl param get limits.linear_mps
      robotctl param set limits.linear_mps 0.4
      robotctl param dump > robot.yaml
    """


@group.command("list")
def list_all(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show every parameter: value, allowed values, and when it changes.

    A value that differs from its default has a star.

    \b
    Examples:
      robotctl param list
      robotctl param list --json | jq '.parameters[].key'
    """
    answer = call(robot, PARAM_LIST)
    print_answer(answer, lines(answer), as_json=as_json)


def lines(answer: ParameterList) -> Iterator[str]:
    """Yield a line for each parameter of the answer."""
    known = answer["parameters"]
    width = column_width([each["key"] for each in known], at_least=10, at_most=40)
    for each in known:
        star = " " if each["value"] == each["default"] else "*"
        value = printable(each["value"])
        yield f"{each['key']:{width}} {star} {value:14} {each['allowed']}; {each['changes']}"


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


@group.command()
def dump(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Print all values as a ROS parameter file, for `start --config` and --params-file.

    \b
    Examples:
      robotctl param dump > robot.yaml
    """
    import yaml

    values = {each["key"]: each["value"] for each in call(robot, PARAM_LIST)["parameters"]}
    text = yaml.safe_dump({"/**": {"ros__parameters": values}}, sort_keys=False)
    print_answer(values, [text.rstrip("\n")], as_json=as_json)
