"""A hidden node that is in a ROS domain for a moment."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Coroutine
from typing import Any, Final, Self

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from robotctl.processes import readable_within
from robotctl.ros.context import close_context, open_context
from robotctl.ros.graph.discovery import Discovery
from robotctl.ros.graph.endpoints import LOOK_NODE

Send = Callable[[dict[str, Any]], None]
"""Sends a report."""

STDIN: Final = 0
"""Readable only when the command has closed it: after the first line it sends nothing."""

SETTLE_S: Final = 3.5
"""How long discovery may take: an announcement that was lost is repeated after 3 s."""

EXPECTED_S: Final = 20.0
"""How long discovery may take of what the daemon has already discovered."""

QUIET_S: Final = 0.1
"""How long the graph must not change until it counts as discovered."""

_POLL_S: Final = 0.01


class Visitor:
    """A node in a ROS domain during a `with` block."""

    def __init__(self, domain_id: int) -> None:
        self._since_s = time.monotonic()
        self._context = open_context(domain_id)
        self.node = Node(
            f"{LOOK_NODE}{os.getpid()}",
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._discovery = Discovery(self.node, domain_id)

    def __enter__(self) -> Self:
        """Return the visitor itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the domain, with everything that was made of the node."""
        close_context(self._context, [self.node], [self._discovery.close])

    @property
    def context(self) -> Context:
        """The context of its node."""
        return self._context

    def settle(self) -> None:
        """Wait until every process in the domain is discovered."""
        self.discover(lambda: False)

    def discover(self, is_known: Callable[[], bool], *, expected: bool = False) -> bool:
        """Wait until something is known, and return whether it is.

        The wait ends when all processes are discovered; of what is `expected` only after 20 s.

        Raises:
            asyncio.CancelledError: The command that asked has closed stdin: it has ended.
        """
        until_s = self._since_s + (EXPECTED_S if expected else SETTLE_S)
        while not is_known():
            if time.monotonic() > until_s:
                return False
            if not expected and (
                self._discovery.is_alone() or self._discovery.is_complete(QUIET_S)
            ):
                return is_known()
            if readable_within(STDIN, _POLL_S):
                raise asyncio.CancelledError
        return True

    def run(self, work: Coroutine[Any, Any, None]) -> None:
        """Run `work` in a loop to its end.

        Raises:
            asyncio.CancelledError: The command that asked has closed stdin: it has ended.
        """
        asyncio.run(_until_stdin_ends(work))


async def _until_stdin_ends(work: Coroutine[Any, Any, None]) -> None:
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(work)

    def end() -> None:
        loop.remove_reader(STDIN)
        task.cancel()

    loop.add_reader(STDIN, end)
    try:
        await task
    finally:
        loop.remove_reader(STDIN)
