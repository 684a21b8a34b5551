"""Opens and closes rclpy contexts that write no log files."""

from __future__ import annotations

import faulthandler
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Final

from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node

BAD_ARGUMENTS = (
    *(_rclpy.RCLError, _rclpy.RCLInvalidROSArgsError, _rclpy.UnknownROSArgsError),
    *(NameValidationException, ParameterException),
)
"""The exceptions that rclpy raises for wrong `--ros-args`."""


_NO_LOG_FILE: Final = ("--ros-args", "--disable-external-lib-logs")
"""Switches off rcl's log file, in which robotctl logs nothing. Otherwise each command would create
an empty one in the user's home, and fail if the home is not writable."""

END_S: Final = 5.0
"""How long the middleware may take to leave a domain. During discovery, Fast DDS 2.14 may deadlock
in `DomainParticipant::set_listener` on its own lock, with the GIL held."""


def open_context(domain_id: int, remaps: Iterable[str] = ()) -> Context:
    """Open a context in ROS domain `domain_id`, without signal handlers; ignore the command line.

    `remaps` are rules FROM:=TO for the names of topics and services.
    """
    context = Context()
    rules = [word for rule in remaps for word in ("-r", rule)]
    context.init(args=[*_NO_LOG_FILE, *rules], domain_id=domain_id)
    return context


def close_context(
    context: Context, nodes: Iterable[Node], before: Iterable[Callable[[], object]] = ()
) -> None:
    """Call the functions of `before`, then destroy the nodes and leave the domain.

    Call this as the last step of a process. If the call takes over END_S, the process prints the
    stacks of its threads on stderr and ends with exit code 1.
    """
    with ExitStack() as leaving:
        faulthandler.dump_traceback_later(END_S, exit=True, file=2)
        leaving.callback(faulthandler.cancel_dump_traceback_later)
        leaving.callback(context.destroy)
        leaving.callback(context.try_shutdown)
        for node in nodes:
            leaving.callback(node.destroy_node)
        for each in before:
            leaving.callback(each)
