"""Print the answer of a command: an object for machines, or lines for people."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import Any

from robotctl.cli.support.failure import drop_output
from robotctl.cli.terminal.text import json_text
from robotctl.errors import RobotctlError


def print_answer(
    answer: Mapping[str, Any],
    lines: Iterable[str],
    *,
    as_json: bool,
    error: RobotctlError | None = None,
) -> None:
    """Print the answer, as one line of JSON or as lines of text, then raise `error` if given.

    With `as_json`, the error carries the answer, so that stdout gets a single object. The error is
    raised even if the reader of stdout has closed it, because it determines the exit code.
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
