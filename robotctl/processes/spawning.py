"""Starts a command as a child process."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from robotctl.processes.child import Child
from robotctl.processes.descriptors import open_pipe
from robotctl.processes.report_lines import REPORT_OPTION

CHILD_FD: Final = 3
"""The number of the pipe in the child, the first after stdin, stdout and stderr."""


def program(module: str) -> tuple[str, ...]:
    """Return the command that runs a module with this Python.

    With -P, a file in the working directory is not imported in place of a library.
    """
    return (sys.executable, "-P", "-m", module)


def start(
    command: Sequence[str],
    *,
    option: str = REPORT_OPTION,
    with_stdin: bool = False,
    log: Path | None = None,
) -> Child:
    """Start `command`; `option` passes it the number of the descriptor for its reports.

    With a `log`, its stdout and stderr go there; it runs in its own session, outlives this process
    and inherits no other descriptors. Without a log, both go to our stderr; it has its own process
    group, so that Ctrl-C in the terminal reaches only this process. Its stdin is a pipe if
    `with_stdin`, else /dev/null.
    """
    ours: list[int] = []
    theirs: list[int] = []
    if log is not None:
        _stop_inheritance()
    try:
        reports, reporting = open_pipe()
        ours.append(reports)
        theirs.append(reporting)
        our_stdin = None
        if with_stdin:
            their_stdin, our_stdin = open_pipe()
            ours.append(our_stdin)
            theirs.append(their_stdin)
            stdin_action: tuple[Any, ...] = (os.POSIX_SPAWN_DUP2, their_stdin, 0)
        else:
            stdin_action = (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)
        pid = os.posix_spawn(
            command[0],
            [*command, option, str(CHILD_FD)],
            os.environ,
            file_actions=[
                stdin_action,
                _output(log),
                (os.POSIX_SPAWN_DUP2, 1, 2),
                (os.POSIX_SPAWN_DUP2, reporting, CHILD_FD),
            ],
            **({"setpgroup": 0} if log is None else {"setsid": True}),
            setsigmask=[],
            setsigdef=[signal.SIGPIPE],
        )
        ours.clear()
    finally:
        for descriptor in (*theirs, *ours):
            os.close(descriptor)
    return Child(pid, reports, our_stdin)


def _stop_inheritance() -> None:
    """Keep inherited descriptors from the child: a lock or pipe of the shell would stay open."""
    with suppress(OSError):  # no /proc
        for descriptor in map(int, os.listdir("/proc/self/fd")):
            if descriptor > 2:
                with suppress(OSError):  # closed meanwhile, like the descriptor of the listing
                    os.set_inheritable(descriptor, False)


def _output(log: Path | None) -> tuple[Any, ...]:
    if log is not None:
        return (os.POSIX_SPAWN_OPEN, 1, log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    try:
        os.fstat(2)
    except OSError:  # closed
        return (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)
    return (os.POSIX_SPAWN_DUP2, 2, 1)
