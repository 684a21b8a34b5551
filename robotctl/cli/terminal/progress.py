"""A progress bar for work that may take long."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from robotctl.cli.terminal.text import is_terminal

Progress = Callable[[int, int], None]
"""Receives how much is done, and the total."""

PERIOD_S: Final = 0.1
"""How often the bar is drawn again, at most."""


@contextmanager
def progress_bar(label: str, *, quiet: bool) -> Iterator[Progress]:
    """Yield a function that draws the progress on a terminal; remove the bar at the end."""
    if quiet or not is_terminal():
        yield lambda done, total: None
        return
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    # It draws without a thread: a check may copy a process with one thread only.
    with Bar(*columns, transient=True, auto_refresh=False) as bar:
        task = bar.add_task(label, total=None)
        drawn_s = 0.0

        def draw(done: int, total: int) -> None:
            nonlocal drawn_s
            if time.monotonic() - drawn_s >= PERIOD_S:
                drawn_s = time.monotonic()
                bar.update(task, completed=done, total=total, refresh=True)

        yield draw
