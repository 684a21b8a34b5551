"""logs: print the log of the background daemon."""

from __future__ import annotations

import json
import os
import re
import time
from collections import deque
from collections.abc import Iterator
from datetime import datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, TextIO

import typer

from robotctl.base.errors import NoDaemon
from robotctl.base.files import open_regular
from robotctl.base.paths import DEFAULT_ROBOT, chain_to, log_path
from robotctl.base.text import without_colours
from robotctl.cli.options import Robot, new_app
from robotctl.cli.targets.recordings import parse_since
from robotctl.cli.ui.text import printable
from robotctl.kernel.constants import NS_PER_S

app = new_app()

_FOLLOW_POLL_S = 0.2

_LINE = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3}) ([A-Z]+) ([^ :]+): (.*)")


@app.command()
def logs(
    robot: Robot = DEFAULT_ROBOT,
    follow: Annotated[
        bool,
        typer.Option("--follow", "-f", help="Print new lines, too, until Ctrl-C."),
    ] = False,
    last: Annotated[
        int | None,
        typer.Option("--lines", "-n", metavar="N", min=0, help="Only the last N lines."),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option("--since", metavar="TIME", help="Only newer lines: 15m, 2h, or a date."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON object for each line, for machines.")
    ] = False,
) -> None:
    """Print the log of the background daemon.

    The log of the previous run is beside it, as daemon.log.1.

    \b
    Examples:
      robotctl logs -f
      robotctl logs -n 20
      robotctl logs --since 15m --json | jq -r .text
    """
    since_ns = 0 if since is None else parse_since(since, time.time_ns())
    path = log_path(robot)
    chain_to(path.parent).check()
    if not path.exists():
        raise NoDaemon(
            f"no log of robot {robot!r}: no daemon was started in the background ({path})"
        )
    begin = 0 if last is None else _begin_of_last(path, last)
    time_ns: int | None = None
    for coloured in _lines(path, follow=follow, begin=begin):
        text = line = without_colours(coloured)
        level = logger = None  # a line without a header continues an entry, and keeps its time
        if match := _LINE.fullmatch(line):
            when, level, logger, text = match.groups()
            time_ns = _time_ns(when)
        if since is None or (time_ns or 0) >= since_ns:
            about = {"t_ns": time_ns, "level": level, "logger": logger, "text": text}
            print(json.dumps(about) if as_json else printable(line), flush=follow)


def _time_ns(when: str) -> int | None:
    try:
        local = datetime.strptime(when, "%Y-%m-%d %H:%M:%S,%f").astimezone()
    except ValueError:  # a date that does not exist, such as 2026-02-31
        return None
    return int(local.replace(microsecond=0).timestamp()) * NS_PER_S + local.microsecond * 1000


def _begin_of_last(path: Path, count: int) -> int:
    """Return the offset of the last `count` lines of the log [bytes]."""
    begins: deque[int] = deque(maxlen=count)
    end = 0
    with open_regular(path) as log:
        for line in log:
            begins.append(end)
            end += len(line)
    return begins[0] if begins else end


def _lines(path: Path, *, follow: bool, begin: int = 0) -> Iterator[str]:
    """Yield the lines of the log from byte `begin`.

    With `follow`, wait for more, and continue with the log of the daemon's next run.
    """
    while True:
        with TextIOWrapper(open_regular(path), errors="replace") as log:
            log.seek(begin)
            begin = 0
            line = ""
            while True:
                piece = log.readline()
                line += piece
                if line.endswith("\n") or (line and not follow):
                    yield line.rstrip("\n")
                    line = ""
                elif not follow:
                    return
                elif not piece:
                    if _is_replaced(path, log):
                        break
                    time.sleep(_FOLLOW_POLL_S)


def _is_replaced(path: Path, log: TextIO) -> bool:
    """Return whether the file at `path` is no longer `log`."""
    return path.exists() and not os.path.samestat(path.stat(), os.fstat(log.fileno()))
