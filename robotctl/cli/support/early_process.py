"""A child process that works while this one imports the option parser, which takes as long."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Final

from robotctl import environment
from robotctl.processes import REPORT_OPTION, Child, fork, has_one_thread, program, start

END_S: Final = 10.0
"""How long a process may take to end."""

_waiting: dict[str, Child] = {}
"""The processes that were started early, by their modules, until they are used."""


@contextmanager
def started_early(module: str) -> Iterator[None]:
    """Start a process that `early_or_new` may use; kill it at the end if it was not used.

    It is a copy of this process, which saves the start of a Python. Where this one has other
    threads, or another ROS precedes ours, it is a new one.
    """
    if has_one_thread() and not environment.has_foreign_ros():
        _waiting[module] = fork(partial(_run, module))
    else:
        _waiting[module] = _new(module)
    try:
        yield
    finally:
        unused = _waiting.pop(module, None)
        if unused is not None:
            unused.kill()
            unused.close(END_S)


def early_or_new(module: str) -> Child:
    """Return a process that runs the module, with a pipe as its stdin; the caller closes it."""
    return _waiting.pop(module, None) or _new(module)


def _new(module: str) -> Child:
    return start(program(module), with_stdin=True)


def _run(module: str, stdin: int, reports: int) -> int:
    """Do in a copy of this process what `_new` lets a new one do."""
    os.dup2(stdin, 0)
    os.close(stdin)
    os.dup2(2, 1)
    exit_code: int = import_module(f"{module}.__main__").main([REPORT_OPTION, str(reports)])
    with suppress(OSError):  # nobody reads stderr any more
        sys.stdout.flush()
    return exit_code
