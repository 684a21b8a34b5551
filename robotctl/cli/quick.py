"""The commands that run without an option parser.

`match` accepts plain spellings only; typer handles all else. The modules in `commands` declare
these commands for typer, with their help, and call the same functions.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from robotctl.base.errors import RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT, ROBOT_VARIABLE
from robotctl.base.text import MODES, find_mode
from robotctl.cli.targets.requests import asked_by, lease_of_shell
from robotctl.cli.ui.status import status_screen_lines
from robotctl.cli.ui.text import json_text, printable
from robotctl.ipc.client import Client, call, command_for
from robotctl.ipc.method_names import RESET, SET_MODE, STATUS, STOP
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

if TYPE_CHECKING:
    from robotctl.ipc.answers import MessageAnswer, ModeAnswer

# Without typer, whose import takes 40 ms: an emergency stop should not wait for it.

VALID_MODES = f"{', '.join(MODES)}, or 0 to {max(MODES.values())}"

STOP_DEADLINE_S = 30.0
"""The timeout for the daemon to ramp down, write the rest of the recording and sync it [s]."""


def status(robot: str, as_json: bool) -> None:
    """Print the daemon's status as a screen of text or one line of JSON."""
    answer = call(robot, STATUS)
    print(json_text(answer) if as_json else "\n".join(status_screen_lines(answer)))


def set_mode(mode: str, robot: str, as_json: bool, reason: str = "") -> None:
    """Request a mode by name or number.

    Raises:
        UsageError: There is no such mode, or the reason is not allowed.
    """
    number = mode_number(mode)
    if number == EMERGENCY_STOP_MODE:
        answer, problem = _stopped("set-mode", robot, reason)
        _show(answer, as_json)
        if problem is not None:
            raise problem
        return
    params = {"mode": number, **asked_by("set-mode", reason), **lease_of_shell()}
    _show(call(robot, SET_MODE, params), as_json)


def estop(robot: str, as_json: bool, reason: str = "", every: bool = False) -> None:
    """Latch the emergency stop of `robot`; if `every`, of all robots of this user.

    Raises:
        UsageError: The reason is not allowed; the stop was latched, without a reason.
        RobotctlError: A robot was not stopped.
    """
    if every:
        _estop_all(as_json, reason)
        return
    answer, problem = _stopped("estop", robot, reason)
    if not as_json:
        _show(answer, as_json, hint=f"release it with: {command_for(robot, 'reset')}")
    from robotctl.cli.targets.robots import others_than

    found = others_than(robot)
    moving = [each.robot for each in found if each.moves]
    silent = [each.robot for each in found if not each.moves]
    if as_json:
        print(json_text({**answer, "others_moving": moving, "others_silent": silent}))
    for verb, names in (("still MOVING", moving), ("no answer from", silent)):
        if names and not as_json:
            print(f"{verb}: {', '.join(names)} (all robots: robotctl estop --all)")
    if problem is not None:
        raise problem


def _estop_all(as_json: bool, reason: str) -> None:
    from robotctl.cli.targets.robots import stop_all
    from robotctl.cli.ui.output import print_answer

    params, problem = _asked_by_or_why_not("estop --all", reason)
    stopped, failure = stop_all(params)
    lines = [f"{each['robot']}: {printable(each['message'])}" for each in stopped]
    print_answer({"robots": stopped}, lines, as_json=as_json, error=failure or problem)


def _stopped(command: str, robot: str, reason: str) -> tuple[ModeAnswer, UsageError | None]:
    """Latch the emergency stop; return the answer, and the error if the reason is not allowed."""
    params, problem = _asked_by_or_why_not(command, reason)
    return call(robot, SET_MODE, {"mode": EMERGENCY_STOP_MODE, **params}), problem


def _asked_by_or_why_not(command: str, reason: str) -> tuple[dict[str, str], UsageError | None]:
    try:
        return asked_by(command, reason), None
    except UsageError as error:
        problem = f"the robot was stopped, but the reason was left out: {error.cause}"
        return asked_by(command), UsageError(problem, error.cure)


def reset(robot: str, as_json: bool, reason: str = "") -> None:
    """Release ERROR or EMERGENCY_STOP to IDLE.

    Raises:
        UsageError: The reason is not allowed.
    """
    _show(call(robot, RESET, asked_by("reset", reason)), as_json)


def stop(robot: str, as_json: bool) -> None:
    """End the daemon, and wait for the end of its process."""
    _show(stop_daemon(robot), as_json)


def stop_daemon(robot: str) -> MessageAnswer:
    """End the daemon, and return its answer after the end of its process.

    Raises:
        RobotctlError: The process is still running after STOP_DEADLINE_S.
    """
    from robotctl.base.processes import pidfd_of, readable_within

    with Client(robot) as client, pidfd_of(client.daemon_pid) as process:
        answer = client.call(STOP)
        if process is not None and not readable_within(process, STOP_DEADLINE_S):
            pid = client.daemon_pid
            raise RobotctlError(
                f"the daemon (pid {pid}) is still running after {STOP_DEADLINE_S:g} s: "
                f"end it with kill -9 {pid}; its recording stays readable"
            )
    return answer


def mode_number(text: str) -> int:
    """Return the number of a mode; `text` is its name (any case, with - or _) or its number.

    Raises:
        UsageError: There is no such mode.
    """
    number = find_mode(text)
    if number is None:
        raise UsageError(f"no mode {text!r}", f"use {VALID_MODES}")
    return number


def _show(answer: MessageAnswer, as_json: bool, hint: str = "") -> None:
    if as_json:
        print(json_text(answer))
    else:
        message = printable(answer.get("message", "done"))
        print(f"{message} ({hint})" if hint else message)


_WITHOUT_ARGUMENT: dict[str, Callable[[str, bool], None]] = {
    "status": status,
    "stop": stop,
}


def match(arguments: list[str]) -> Callable[[], None] | None:
    """Return a function that runs the command in `arguments`; None if typer must parse them."""
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
            return partial(estop, robot, as_json, reason or "", every)
        case _ if every:
            return None
        case ["set-mode", mode]:
            return partial(set_mode, mode, robot, as_json, reason or "")
        case ["reset"]:
            return partial(reset, robot, as_json, reason or "")
        case [name] if name in _WITHOUT_ARGUMENT and reason is None:
            return partial(_WITHOUT_ARGUMENT[name], robot, as_json)
    return None
