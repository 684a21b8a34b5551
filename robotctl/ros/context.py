"""Opening and closing an rclpy context that leaves nothing on the disk."""

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
"""What rclpy raises for wrong `--ros-args`."""


_NO_LOG_FILE: Final = ("--ros-args", "--disable-external-lib-logs")
"""robotctl does not log through rcl: rcl would create an empty file in the user's home at every
command, and fail where that cannot be written."""

END_S: Final = 5.0
"""How long the middleware may take to leave a domain. During discovery, Fast DDS 2.14 may deadlock
in `DomainParticipant::set_listener` on its own lock, with the GIL held."""


def open_context(domain_id: int, remaps: Iterable[str] = ()) -> Context:
    """Open a context in this domain, without signal handlers and arguments of our command line.

    `remaps` are rules FROM:=TO for the names of topics and services.
    """
    context = Context()
    rules = [word for rule in remaps for word in ("-r", rule)]
    context.init(args=[*_NO_LOG_FILE, *rules], domain_id=domain_id)
    return context


def close_context(
    context: Context, nodes: Iterable[Node], before: Iterable[Callable[[], object]] = ()
) -> None:
    """Call what is to be done `before`, destroy the nodes and leave the domain.

    It is the last thing that a process does.

    Where that takes more than END_S, the process ends with exit code 1 and prints on stderr where
    its threads were.
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
