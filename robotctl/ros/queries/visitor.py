"""A process that visits a ROS domain for one command."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from typing import Final

from robotctl.base.processes import readable_within
from robotctl.ros.graph.endpoints import LOOK_NODE
from robotctl.ros.graph.membership import Membership

STDIN: Final = 0
"""Readable only when the command has closed it: after the first line it sends nothing."""

SETTLE_S: Final = 3.5
"""How long discovery may take: an announcement that was lost is repeated after 3 s."""

EXPECTED_S: Final = 20.0
"""How long discovery may take of what the daemon has already discovered."""

QUIET_S: Final = 0.1
"""How long the graph must not change until it counts as discovered."""

_POLL_S: Final = 0.01


class Visitor(Membership):
    """A membership that ends with stdin."""

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, f"{LOOK_NODE}{os.getpid()}")

    def settle(self) -> None:
        """Wait until every process in the domain is discovered."""
        self.discover(lambda: False)

    def discover(self, is_known: Callable[[], bool], *, expected: bool = False) -> bool:
        """Wait until something is known, and return whether it is.

        The wait ends when all processes are discovered; of what is `expected` only after 20 s.

        Raises:
            asyncio.CancelledError: The command that asked has closed stdin: it has ended.
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
