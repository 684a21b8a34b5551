"""The commands that must not wait for an option parser.

An emergency stop, and a script that asks for the status ten times a second, should not pay 40 ms
for importing typer. What is spelt plainly is carried out at once; everything else, a misspelling
or `--help` among it, is left to typer, which declares the same commands in full.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial

from robotctl.cli.support import control
from robotctl.paths import DEFAULT_ROBOT

ROBOT_VARIABLE = "ROBOTCTL_ROBOT"

_WITHOUT_ARGUMENT: dict[str, Callable[[str, bool], None]] = {
    "status": control.status,
    "estop": control.estop,
    "reset": control.reset,
    "stop": control.stop,
}


def match(arguments: list[str]) -> Callable[[], None] | None:
    """The command that the arguments plainly spell, ready to be called, or None."""
    robot = os.environ.get(ROBOT_VARIABLE) or DEFAULT_ROBOT
    as_json = False
    words: list[str] = []
    rest = iter(arguments)
    for argument in rest:
        if argument == "--json":
            as_json = True
        elif argument == "--robot":
            robot = next(rest, "")
        elif argument.startswith("-"):
            return None
        else:
            words.append(argument)
    if not robot or robot.startswith("-") or arguments[:1] != words[:1]:
        return None
    match words:
        case ["set-mode", mode]:
            return partial(control.set_mode, mode, robot, as_json)
        case [name] if name in _WITHOUT_ARGUMENT:
            return partial(_WITHOUT_ARGUMENT[name], robot, as_json)
    return None
