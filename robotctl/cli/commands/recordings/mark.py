"""mark: mark this moment in the recording."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import moment, printable
from robotctl.ipc.client import call
from robotctl.ipc.method_names import MARK
from robotctl.ipc.protocol import MAX_MARK_LENGTH

app = new_app()


@app.command()
def mark(
    text: Annotated[str, typer.Argument(metavar="TEXT", help="The name of the mark, on one line.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Mark this moment in the recording.

    The mark is also published on robotctl/marks. To cut a clip around it, use
    robotctl clip --event mark.

    \b
    Examples:
      robotctl mark "the door opened"
    """
    text = text.strip()
    if not 0 < len(text) <= MAX_MARK_LENGTH:
        raise UsageError(f"a mark has 1 to {MAX_MARK_LENGTH} characters, not {len(text)}")
    answer = call(robot, MARK, {"text": text, "source": request_source("mark")})
    line = f"marked {moment(answer['time_ns'])}: {printable(text)}"
    print_answer(answer, [line], as_json=as_json)
