"""The commands that run without an option parser.

An emergency stop, or a script that polls the status ten times a second, should not wait 40 ms for
the import of typer. `match` accepts plain spellings only; everything else, such as `--help` or a
misspelling, goes to typer. The modules of the same names in `commands` declare these commands for
typer, with their help, and `support.quick_actions` implements them for both.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial

from robotctl.cli.support import quick_actions
from robotctl.paths import DEFAULT_ROBOT, ROBOT_VARIABLE

_WITHOUT_ARGUMENT: dict[str, Callable[[str, bool], None]] = {
    "status": quick_actions.status,
    "stop": quick_actions.stop,
}


def match(arguments: list[str]) -> Callable[[], None] | None:
    """Return the call that the arguments spell, or None if typer has to parse them."""
    robot = os.environ.get(ROBOT_VARIABLE) or DEFAULT_ROBOT
    as_json = False
    reason: str | None = None
    every = False
    words: list[str] = []
    rest = iter(arguments)
    for argument in rest:
        if argument == "--json":
            as_json = True
        elif argument == "--robot":
            robot = next(rest, "")
        elif argument == "--all":
            every = True
        elif argument == "--reason":
            reason = next(rest, "-")
        elif argument.startswith("-"):
            return None
        else:
            words.append(argument)
    if (
        (reason or "").startswith("-")
        or not robot
        or robot.startswith("-")
        or arguments[:1] != words[:1]
    ):
        return None
    match words:
        case ["estop"]:
            return partial(quick_actions.estop, robot, as_json, reason or "", every)
        case _ if every:
            return None
        case ["set-mode", mode]:
            return partial(quick_actions.set_mode, mode, robot, as_json, reason or "")
        case ["reset"]:
            return partial(quick_actions.reset, robot, as_json, reason or "")
        case [name] if name in _WITHOUT_ARGUMENT and reason is None:
            return partial(_WITHOUT_ARGUMENT[name], robot, as_json)
    return None
