"""The live status around the work of a command: a drive, or the demo."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from robotctl.cli.support.background import Background
from robotctl.cli.terminal.status_line import HEADER, status_line
from robotctl.cli.terminal.text import is_terminal
from robotctl.errors import RobotctlError
from robotctl.ipc.answers import Status
from robotctl.ipc.client import call
from robotctl.ipc.method_names import STATUS

POLL_S = 0.1
LINE_S = 1.0
"""The period without a terminal, so that a log file gets one line per second."""


def polled_until(working: Background[Any], robot: str) -> Iterator[Status]:
    """Yield the daemon's status until the work is done; nothing if it is done at once.

    Failed polls are skipped, because the work itself reports how it ended.
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
    """Draw each status over the previous one, or print a line for each without a terminal."""
    if not is_terminal():
        for row, status in enumerate(statuses):
            if row == 0:
                print(HEADER)
            print(status_line(status), flush=True)
        return
    from rich.live import Live

    from robotctl.cli.terminal.status_panel import live_view

    with Live(auto_refresh=False) as live:
        for status in statuses:
            live.update(live_view(status), refresh=True)
