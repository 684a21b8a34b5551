"""The output of a command: its answer, its error, and a progress bar."""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final, TextIO

from robotctl.base.errors import IN_PARENTHESES, Interrupted, RobotctlError, UsageError
from robotctl.cli.ui.text import is_terminal, json_text, printable


def report(error: BaseException, *, as_json: bool) -> int:
    """Print the reason of a failure to stderr, and return the exit code of the process.

    With `as_json`, stdout gets the error's partial answer with the key `error`.
    """
    failure = _as_robotctl_error(error)
    if as_json:
        try:
            print(json_text({**failure.answer, "error": failure.as_object()}), flush=True)
        except OSError:
            drop_output(sys.stdout)
    if str(failure):
        try:
            print(f"robotctl: {printable(failure)}", file=sys.stderr, flush=True)
        except OSError:
            drop_output(sys.stderr)
    return failure.exit_code


def drop_output(stream: TextIO) -> None:
    """Discard the text that `stream` has buffered."""
    # Otherwise Python would write the text again at exit, and exit with 120.
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _as_robotctl_error(error: BaseException) -> RobotctlError:
    if isinstance(error, RobotctlError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted()
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        if error.filename is None:
            drop_output(sys.stdout)
        return RobotctlError(
            f"no space left on the disk for {error.filename or 'the output'}", "free some"
        )
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return RobotctlError("too many open files", "raise the limit (ulimit -n)")
    if isinstance(error, OSError) and error.errno == errno.ENOENT and _is_working_folder_gone():
        return UsageError("the working folder was removed", "cd to a folder that exists")
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return RobotctlError(f"{error.filename}: {error.strerror}")
    return RobotctlError(
        f"unexpected {type(error).__name__}: {error}",
        "see where with: robotctl --debug ...",
        sentence=IN_PARENTHESES,
    )


def _is_working_folder_gone() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return True
    return False


def print_answer(
    answer: Mapping[str, Any],
    lines: Iterable[str],
    *,
    as_json: bool,
    error: RobotctlError | None = None,
) -> None:
    """Print the answer as one line of JSON or as lines of text, then raise `error` if given.

    With `as_json`, nothing is printed before an error: the error carries the answer.
    """
    if error is not None and as_json:
        error.answer = answer
        raise error
    try:
        print(json_text(answer) if as_json else "\n".join(lines), flush=True)
    except BrokenPipeError:
        drop_output(sys.stdout)
    if error is not None:
        raise error


Progress = Callable[[int, int], None]
"""A function that is called as work proceeds, with the amount done and the total amount."""

REDRAW_S: Final = 0.1
"""The shortest time between two drawings of the bar [s]."""


@contextmanager
def progress_bar(label: str, *, quiet: bool) -> Iterator[Progress]:
    """Yield a function that draws the progress on a terminal."""
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
    # No thread refreshes the bar: it is drawn when the work calls `draw`.
    with Bar(*columns, transient=True, auto_refresh=False) as bar:
        task = bar.add_task(label, total=None)
        drawn_s = 0.0

        def draw(done: int, total: int) -> None:
            nonlocal drawn_s
            if time.monotonic() - drawn_s >= REDRAW_S:
                drawn_s = time.monotonic()
                bar.update(task, completed=done, total=total, refresh=True)

        yield draw
