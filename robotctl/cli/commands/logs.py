"""logs: print the log of the background daemon."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, TextIO

import typer

from robotctl.cli.options import Robot, new_app
from robotctl.cli.terminal.text import printable
from robotctl.errors import NoDaemon
from robotctl.paths import DEFAULT_ROBOT, chain_to, log_path
from robotctl.printable import without_colours
from robotctl.regular_file import open_regular

app = new_app()

_FOLLOW_POLL_S = 0.2


@app.command()
def logs(
    robot: Robot = DEFAULT_ROBOT,
    follow: Annotated[
        bool,
        typer.Option("--follow", "-f", help="Print new lines, too, until Ctrl-C."),
    ] = False,
) -> None:
    """Print the log of the background daemon.

    The log of the previous run is beside it, as daemon.log.1.

    \b
    Examples:
      robotctl logs -f
    """
    path = log_path(robot)
    chain_to(path.parent).check()
    if not path.exists():
        raise NoDaemon(
            f"no log of robot {robot!r}: no daemon was started in the background ({path})"
        )
    for line in _lines(path, follow=follow):
        print(printable(without_colours(line)), flush=follow)


def _lines(path: Path, *, follow: bool) -> Iterator[str]:
    """Yield the lines of the log; with `follow`, wait for more, also after a restart."""
    while True:
        with TextIOWrapper(open_regular(path), errors="replace") as log:
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
    """Return whether the next start has put another file at the path."""
    return path.exists() and not os.path.samestat(path.stat(), os.fstat(log.fileno()))
