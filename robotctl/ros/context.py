"""A process's part in a ROS domain, of which nothing remains on the disk."""

from __future__ import annotations

import faulthandler
from collections.abc import Iterable
from contextlib import ExitStack
from typing import Final

from rclpy.context import Context
from rclpy.node import Node

_NO_LOG_FILE: Final = ("--ros-args", "--disable-external-lib-logs")
"""Nothing of ours is logged through rcl, which would leave an empty file in the user's home with
every command, and not begin at all where it cannot be written."""

END_S: Final = 5.0
"""How long the middleware may take to leave a domain. Fast DDS 2.14, while it discovers others, may
wait for ever in `DomainParticipant::set_listener`, for its own lock and with the GIL held."""


def open_context(domain_id: int) -> Context:
    """Return a context in this domain; it hears neither of our command line nor of signals."""
    context = Context()
    context.init(args=list(_NO_LOG_FILE), domain_id=domain_id)
    return context


def close_context(context: Context, nodes: Iterable[Node]) -> None:
    """Leave the domain, with these nodes: the last thing that a process does, all else said.

    Where the middleware does not let go, the process ends with exit code 1 and says on stderr
    where it was.
    """
    with ExitStack() as leaving:
        faulthandler.dump_traceback_later(END_S, exit=True, file=2)
        leaving.callback(faulthandler.cancel_dump_traceback_later)
        leaving.callback(context.destroy)
        leaving.callback(context.try_shutdown)
        for node in nodes:
            leaving.callback(node.destroy_node)
