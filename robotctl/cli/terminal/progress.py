"""A progress bar for work that may take long."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from robotctl.cli.terminal.text import is_terminal

Progress = Callable[[int, int], None]
"""Receives how much is done, and the total."""


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
    with Bar(*columns, transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
