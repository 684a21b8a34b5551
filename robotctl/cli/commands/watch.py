"""watch: the live view of a running daemon."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from robotctl.cli.options import Robot, new_app
from robotctl.cli.support.background import Background
from robotctl.cli.terminal.status_line import HEADER, status_line
from robotctl.cli.terminal.text import is_terminal
from robotctl.errors import RobotctlError
from robotctl.ipc.answers import Status
from robotctl.ipc.client import call
from robotctl.ipc.method_names import STATUS
from robotctl.paths import DEFAULT_ROBOT

app = new_app()

POLL_S = 0.1
LINE_S = 1.0
"""Without a terminal: a log file gets a line a second, not ten."""


@app.command()
def watch(robot: Robot = DEFAULT_ROBOT) -> None:
    """Watch mode, pose, speed, battery, recorder and topics, live.

    Ends with Ctrl-C, or with the daemon. Through a pipe it prints a line a second.

    \b
    Examples:
      robotctl watch
      robotctl watch | tee run.log
    """
    show(polled(robot))


def polled(robot: str) -> Iterator[Status]:
    """The daemon's status, as often as it can be shown; ends with NoDaemon when the daemon does."""
    period_s = POLL_S if is_terminal() else LINE_S
    while True:
        yield call(robot, STATUS)
        time.sleep(period_s)


def polled_until(working: Background[Any], robot: str) -> Iterator[Status]:
    """The daemon's status until the work is done; nothing of work that is done at once.

    A poll that fails is left out: the work itself says how it ends.
    """
    period_s = POLL_S if is_terminal() else LINE_S
    working.join(POLL_S)
    while not working.is_done:
        try:
            status = call(robot, STATUS)
        except RobotctlError:
            pass
        else:
            yield status
        time.sleep(period_s)


def show(statuses: Iterator[Status]) -> None:
    """Draw each status over the one before, or print a line each where there is no terminal."""
    if not is_terminal():
        for row, status in enumerate(statuses):
            if row == 0:
                print(HEADER)
            print(status_line(status), flush=True)
        return
    from rich.live import Live

    from robotctl.cli.terminal.live_view import live_view

    with Live(auto_refresh=False) as live:
        for status in statuses:
            live.update(live_view(status), refresh=True)
