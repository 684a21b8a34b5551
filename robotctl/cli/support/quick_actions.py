"""What status, set-mode, estop, reset and stop do.

`quick` and the typer commands of the same names call these functions; none of them needs typer.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

from robotctl.cli.support.lease_token import own_token
from robotctl.cli.ui.status import status_screen_lines
from robotctl.cli.ui.text import json_text, printable
from robotctl.errors import RobotctlError, UsageError
from robotctl.ipc.client import Client, call, command_for
from robotctl.ipc.method_names import RESET, SET_MODE, STATUS, STOP
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE, MAX_REASON, REASON_PATTERN
from robotctl.mode_names import MODES, find_mode

if TYPE_CHECKING:
    from robotctl.ipc.answers import ModeAnswer, Stopped

VALID_MODES = f"{', '.join(MODES)}, or 0 to {max(MODES.values())}"

STOP_DEADLINE_S = 30.0
"""How long the daemon may take to ramp down, write the rest of the recording and sync it."""


def status(robot: str, as_json: bool) -> None:
    """Print the daemon's status, as a screen of text or one line of JSON."""
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
    """Latch the emergency stop, of `every` robot of this user or of one.

    Raises:
        UsageError: The reason was left out: it is not allowed.
        RobotctlError: A robot was not stopped.
    """
    if every:
        _estop_all(as_json, reason)
        return
    answer, problem = _stopped("estop", robot, reason)
    if not as_json:
        _show(answer, as_json, hint=f"release it with: {command_for(robot, 'reset')}")
    others = _others_than(robot)
    if as_json:
        print(json_text({**answer, **others}))
    else:
        _show_others(others)
    if problem is not None:
        raise problem


def _others_than(robot: str) -> dict[str, list[str]]:
    """Return the names of other robots that move, and of those that do not answer."""
    from robotctl.cli.support.estop_all import others_than

    found = others_than(robot)
    return {
        "others_moving": [each.robot for each in found if each.moves],
        "others_silent": [each.robot for each in found if not each.moves],
    }


def _show_others(others: dict[str, list[str]]) -> None:
    for verb, names in (("still MOVING", "others_moving"), ("no answer from", "others_silent")):
        if others[names]:
            print(f"{verb}: {', '.join(others[names])} (all robots: robotctl estop --all)")


def _estop_all(as_json: bool, reason: str) -> None:
    from robotctl.cli.support.estop_all import stop_all
    from robotctl.cli.ui.output import print_answer

    params, problem = _asked_by_or_why_not("estop --all", reason)
    stopped, failure = stop_all(params)
    lines = [f"{each['robot']}: {printable(each['message'])}" for each in stopped]
    print_answer({"robots": stopped}, lines, as_json=as_json, error=failure or problem)


def _stopped(command: str, robot: str, reason: str) -> tuple[ModeAnswer, UsageError | None]:
    """Stop the robot in any case; return what is wrong with the reason as well."""
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
    """End the daemon, and return when its process has ended."""
    _show(stop_daemon(robot), as_json)


def stop_daemon(robot: str) -> Stopped:
    """Ask the daemon to end, and return its answer when its process has ended."""
    from robotctl.processes import pidfd_of, readable_within

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
    """Return the number of a mode given by name, in any case, with - or _, or as 0 to 3.

    Raises:
        UsageError: There is no such mode.
    """
    number = find_mode(text)
    if number is None:
        raise UsageError(f"no mode {text!r}", f"use {VALID_MODES}")
    return number


def asked_by(command: str, reason: str = "") -> dict[str, str]:
    """Return who asks and why, as parameters of a request.

    Raises:
        UsageError: The reason is not allowed.
    """
    params = {"source": request_source(command)}
    return {**params, "reason": checked_reason(reason)} if reason else params


def checked_reason(reason: str) -> str:
    """Return the reason if a daemon takes it.

    Raises:
        UsageError: It is too long, or has control characters.
    """
    if len(reason) > MAX_REASON:
        problem = f"--reason of {len(reason)} characters"
    elif not re.match(REASON_PATTERN, reason):
        problem = "--reason with control characters"
    else:
        return reason
    raise UsageError(problem, f"use at most {MAX_REASON} characters on one line")


def lease_of_shell() -> dict[str, str]:
    """Return the lease for which the commands of this shell act, as parameters of a request."""
    token = own_token()
    return {"lease": token} if token else {}


def request_source(command: str) -> str:
    """Return the name of the requester, for the daemon's log and journal."""
    return f"robotctl {command} (uid {os.getuid()}, pid {os.getpid()})"


def _show(answer: ModeAnswer | Stopped, as_json: bool, hint: str = "") -> None:
    if as_json:
        print(json_text(answer))
    else:
        message = printable(answer.get("message", "done"))
        print(f"{message} ({hint})" if hint else message)
