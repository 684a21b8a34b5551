"""param list: every parameter with its value."""

from __future__ import annotations

from collections.abc import Iterator

from robotctl.cli.commands.param.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.text import column_width, printable
from robotctl.ipc.answers import ParameterList
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST
from robotctl.paths import DEFAULT_ROBOT


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
