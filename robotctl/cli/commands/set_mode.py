"""set-mode, estop, reset: their options and help (`cli.quick` implements them); preflight."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Annotated

import typer

from robotctl.base.errors import Refused
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Reason, Robot, new_app
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable
from robotctl.ipc.answers import Preflight
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PREFLIGHT

app = new_app()


@app.command("set-mode")
def set_mode(
    mode: Annotated[
        str,
        typer.Argument(metavar="MODE", help=f"{quick.VALID_MODES}; names in any case."),
    ],
    reason: Reason = "",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Ask for a mode; `moving` drives the configured pattern.

    A refusal names the condition that does not hold and exits with code 4.

    \b
    Examples:
      robotctl set-mode moving
      robotctl set-mode EMERGENCY_STOP
      robotctl set-mode 0
    """
    quick.set_mode(mode, robot, as_json, reason)


@app.command()
def estop(
    reason: Reason = "",
    every: Annotated[bool, typer.Option("--all", help="Stop every robot of this user.")] = False,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Stop at once and latch EMERGENCY_STOP.

    This is a software stop, not a safety-rated one. It stays latched over restarts and reboots,
    until robotctl reset. It names the other robots that still move.

    \b
    Examples:
      robotctl estop
      robotctl estop --robot r2 --reason "a child ran in"
      robotctl estop --all
    """
    quick.estop(robot, as_json, reason, every)


@app.command()
def reset(reason: Reason = "", robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Release EMERGENCY_STOP or ERROR to IDLE; nothing moves yet.

    Refused, with exit code 4, while the cause persists.

    \b
    Examples:
      robotctl reset
    """
    quick.reset(robot, as_json, reason)


POLL_S = 0.2


@app.command()
def preflight(
    wait: Annotated[
        float,
        typer.Option(metavar="S", min=0.0, max=3600.0, help="Wait so long for all to pass."),
    ] = 0.0,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Show whether the robot may move.

    Each start condition is shown as passed, or as failed with its cure. The daemon checks the same
    conditions before each start of a motion. Exit code 0 if all pass, 4 if one fails.

    \b
    Examples:
      robotctl preflight
      robotctl preflight --wait 30
    """
    end = time.monotonic() + wait
    answer = call(robot, PREFLIGHT)
    while not answer["passed"] and time.monotonic() < end:
        time.sleep(POLL_S)
        answer = call(robot, PREFLIGHT)
    failed = [each for each in answer["conditions"] if each["problem"]]
    error = None
    if failed:
        count = f"{len(failed)} of {len(answer['conditions'])} start conditions"
        error = Refused(f"{count} failed: {failed[0]['problem']}", failed[0]["cure"])
    print_answer(answer, lines(answer), as_json=as_json, error=error)


def lines(answer: Preflight) -> Iterator[str]:
    """Yield a line for each start condition, and one for the cure of a failed condition."""
    width = max(len(each["condition"]) for each in answer["conditions"])
    for each in answer["conditions"]:
        if not each["problem"]:
            yield f"passed  {each['condition']}"
            continue
        yield f"FAILED  {each['condition']:{width}}  {printable(each['problem'])}"
        if each["cure"]:
            yield f"        {printable(each['cure'])}"
