"""record, mark: show or split the current recording, and mark a moment in it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app, new_group
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import column_width, columns, elided, moment, printable, short_path, size
from robotctl.ipc.answers import CountsAnswer, RecordStatus
from robotctl.ipc.client import call
from robotctl.ipc.method_names import MARK, RECORD_SPLIT, RECORD_STATUS
from robotctl.ipc.protocol import MAX_MARK_LENGTH

app = new_app()
group = new_group(app, "record")

SPLIT_DEADLINE_S = 15.0

_COUNTS = {
    name: max(len(name), 6)
    for name in ("received", *CountsAnswer.__annotations__, "unseen")
    if name != "throttled"
}
"""The counters of a topic and their column widths, without `throttled`."""

_MIN_NAME_WIDTH = 24

_COUNT_HEADER = " ".join(f"{title:>{width}}" for title, width in _COUNTS.items())


@group.callback()
def record() -> None:
    """Inspect or split the current recording.

    \b
    Examples:
      robotctl record status
      robotctl record split
    """


@group.command()
def status(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show received, written and lost messages of each topic.

    received = written + queued + dropped. Messages that never arrived are counted as lost if they
    were sent after the first one that arrived, and as unseen if before it. Throttled are those that
    recording.throttle or recording.min_free_gb left out.

    \b
    Examples:
      robotctl record status
      robotctl record status --json | jq .recorder.lost
    """
    answer = call(robot, RECORD_STATUS)
    print_answer(answer, status_lines(answer), as_json=as_json)


@group.command()
def split(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Finish the current file and continue in a new one.

    There is no gap between the two files.

    \b
    Examples:
      robotctl record split
    """
    answer = call(robot, RECORD_SPLIT, deadline_s=SPLIT_DEADLINE_S)
    print_answer(answer, [printable(answer["message"])], as_json=as_json)


def status_lines(answer: RecordStatus) -> Iterator[str]:
    """Yield the lines of `robotctl record status`; `answer` is the object of its `--json`."""
    recorder = answer["recorder"]
    written = size(recorder.get("bytes") or 0)
    yield f"{printable(recorder.get('state'))}: {short_path(recorder.get('file'))}, {written}"
    names = [topic.get("name") for topic in answer["topics"]]
    most = columns() - len("   ") - len(_COUNT_HEADER)
    name_width = column_width(names, at_least=_MIN_NAME_WIDTH, at_most=most)
    yield f"  {'topic':{name_width}} {_COUNT_HEADER}"
    for topic in answer["topics"]:
        known = {"received": topic.get("count"), **topic}
        counts = " ".join(f"{known.get(key) or 0:>{width}}" for key, width in _COUNTS.items())
        yield f"  {elided(topic.get('name'), name_width):{name_width}} {counts}"
    for topic in answer["topics"]:
        if throttled := topic.get("throttled"):
            yield f"throttled: {throttled} messages of {printable(topic.get('name'))}"
    yield from (f"warning: {printable(warning)}" for warning in answer["warnings"])


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
