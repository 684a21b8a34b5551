"""preflight: whether the robot may start to move."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Annotated

import typer

from robotctl.base.errors import Refused
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable
from robotctl.ipc.answers import Preflight
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PREFLIGHT

POLL_S = 0.2

app = new_app()


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

    Each start condition has passed, or failed with its cure. The daemon checks the same ones before
    each start of a motion. Exit code 0 if all pass, 4 if one fails.

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
    """Yield a line for each condition; a failed condition has a second line with the cure."""
    width = max(len(each["condition"]) for each in answer["conditions"])
    for each in answer["conditions"]:
        if not each["problem"]:
            yield f"passed  {each['condition']}"
            continue
        yield f"FAILED  {each['condition']:{width}}  {printable(each['problem'])}"
        if each["cure"]:
            yield f"        {printable(each['cure'])}"
