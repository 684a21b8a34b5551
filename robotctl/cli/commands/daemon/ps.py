"""ps: list every robot of this user."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from robotctl.cli.options import Json, new_app
from robotctl.cli.targets import robots
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.status import mode_text
from robotctl.cli.ui.text import printable, short_path

app = new_app()


@app.command()
def ps(as_json: Json = False) -> None:
    """List every robot of this user: mode, pid and recording.

    \b
    Examples:
      robotctl ps
      robotctl ps --json
    """
    answers = [_answer(each) for each in robots.find(robots.names())]
    print_answer({"robots": answers}, _lines(answers), as_json=as_json)


def _answer(found: robots.RobotDaemon) -> dict[str, Any]:
    status = found.status
    return {
        "robot": found.robot,
        "mode": None if status is None else status["mode"],
        "pid": None if status is None else status["pid"],
        "recording": "" if status is None else status["recorder"]["file"],
        "lease": None if status is None else status["lease"],
        "problem": found.problem,
    }


def _lines(answers: list[dict[str, Any]]) -> Iterator[str]:
    if not answers:
        yield "no daemon runs"
        return
    yield f"{'ROBOT':16} {'MODE':22} {'PID':>8}  RECORDING"
    for each in answers:
        if each["problem"]:
            yield f"{printable(each['robot']):16} {printable(each['problem'])}"
        else:
            recording = short_path(each["recording"]) if each["recording"] else ""
            yield f"{each['robot']:16} {mode_text(each):22} {each['pid']:>8}  {recording}"
