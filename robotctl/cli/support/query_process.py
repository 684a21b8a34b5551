"""The process that looks at ROS for a command: started early, and left to end on its own.

It imports rclpy while the command's own process imports the option parser, and leaves the domain
while the user reads the answer.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final

from robotctl.cli.support.early_process import END_S, early_or_new, started_early
from robotctl.paths import DEFAULT_ROBOT, ROBOT_VARIABLE, socket_path
from robotctl.processes import Child

QUERY: Final = "robotctl.ros.queries"

_ALWAYS: Final = (("service", "call"), ("topic", "echo"), ("topic", "hz"))
"""The commands that look through a process of their own even where a daemon runs."""

_WITHOUT_DAEMON: Final = (
    *(("topic", "list"), ("topic", "info"), ("service", "list")),
    *(("node", "list"), ("node", "info")),
)

_OTHERWISE: Final = ("--file", "--help", "-h")
"""Options with which these commands do not look at ROS."""

_leaving: list[Child] = []
"""Processes that were asked to end."""


@contextmanager
def query_processes(arguments: Sequence[str]) -> Iterator[None]:
    """Start the process if the command line seems to need it; at the end, wait for all to leave."""
    command = tuple(arguments[:2])
    needed = command in _ALWAYS or (command in _WITHOUT_DAEMON and not _may_have_daemon(arguments))
    with ExitStack() as at_end:
        at_end.callback(_wait_until_left)
        if needed and not any(word.partition("=")[0] in _OTHERWISE for word in arguments):
            at_end.enter_context(started_early(QUERY))
        yield


def query_process() -> Child:
    """Return a process that has not been asked for anything yet; the caller closes it."""
    return early_or_new(QUERY)


def leave(child: Child) -> None:
    """Ask a process to end; the end of `query_processes` waits for it."""
    child.close_stdin()
    _leaving.append(child)


def _wait_until_left() -> None:
    while _leaving:
        _leaving.pop().close(END_S)


def _may_have_daemon(arguments: Sequence[str]) -> bool:
    """Return whether a daemon may answer; a wrong guess costs time only."""
    options = {word.partition("=")[0] for word in arguments}
    if "--domain-id" in options:
        return False
    return (
        "--robot" in options
        or socket_path(os.environ.get(ROBOT_VARIABLE) or DEFAULT_ROBOT).exists()
    )
