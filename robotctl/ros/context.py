"""Opens and closes rclpy contexts that write no log files, and joins a domain for a command."""

from __future__ import annotations

import asyncio
import faulthandler
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Final, Self

from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from robotctl.base.domains import is_certainly_empty
from robotctl.base.processes import readable_within

BAD_ARGUMENTS = (
    *(_rclpy.RCLError, _rclpy.RCLInvalidROSArgsError, _rclpy.UnknownROSArgsError),
    *(NameValidationException, ParameterException),
)
"""The exceptions of rclpy for wrong `--ros-args`."""


# Otherwise each command would create an empty file in the user's home, or fail to.
_NO_LOG_FILE: Final = ("--ros-args", "--disable-external-lib-logs")
"""Switches off rcl's log file, in which robotctl logs nothing."""

# During discovery, Fast DDS 2.14 may deadlock in `DomainParticipant::set_listener` on its own lock,
# with the GIL held.
END_S: Final = 5.0
"""Limit on the time of `close_context`."""


def open_context(domain_id: int, remaps: Iterable[str] = ()) -> Context:
    """Open a context in ROS domain `domain_id`, without signal handlers or command line.

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

    Call this as the last step of a process. If the call takes over END_S, it prints the stacks of
    all threads on stderr and ends the process with exit code 1.
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


STDIN: Final = 0
"""Stdin's descriptor. It is readable when the command has closed stdin."""

SETTLE_S: Final = 3.5
"""Limit on the time of discovery, as a process repeats a lost announcement after 3 s."""

EXPECTED_S: Final = 20.0
"""Limit on the wait for a name that the daemon has discovered."""

QUIET_S: Final = 0.1
"""Discovery is complete when the graph has not changed for this time."""

_POLL_S: Final = 0.01


class Membership:
    """A node in a ROS domain, which it leaves at the end of the `with` block."""

    def __init__(self, domain_id: int, node_name: str) -> None:
        self.domain_id = domain_id
        self.was_certainly_empty = is_certainly_empty(domain_id)
        """Whether the domain surely had no other process before this one."""

        self.since_s = time.monotonic()
        self._context = open_context(domain_id)
        self.node = Node(
            node_name,
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        # Imported only here: the middleware discovers other processes during the import.
        # The module imports little, so that discovery begins early.
        from robotctl.ros.graph.discovery import Discovery

        self.discovery = Discovery(self.node, domain_id)

    def discover(self, is_known: Callable[[], bool], *, expected: bool = False) -> bool:
        """Wait until `is_known()` is true. Return whether it became true in time.

        The wait ends when discovery is complete, at the latest SETTLE_S after the domain was
        joined. If `expected`, it goes on after that, until EXPECTED_S after the domain was joined.

        Raises:
            asyncio.CancelledError: Stdin was closed.
        """
        until_s = self.since_s + (EXPECTED_S if expected else SETTLE_S)
        while not is_known():
            if time.monotonic() > until_s:
                return False
            if not expected and (self.discovery.is_alone() or self.discovery.is_complete(QUIET_S)):
                return is_known()
            if readable_within(STDIN, _POLL_S):
                raise asyncio.CancelledError
        return True

    def __enter__(self) -> Self:
        """Return the membership itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the discovery, destroy the node and leave the domain."""
        close_context(self._context, [self.node], [self.discovery.close])
