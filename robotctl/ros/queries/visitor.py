"""Joins a ROS domain to answer one command, until the command ends."""

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
"""Readable only after the command has closed it, as its single line was read before."""

SETTLE_S: Final = 3.5
"""How long discovery may take: a process repeats a lost announcement after 3 s."""

EXPECTED_S: Final = 20.0
"""How long to wait for a name that exists for sure, because the daemon has discovered it."""

QUIET_S: Final = 0.1
"""Discovery counts as complete when the graph has not changed for this time."""

_POLL_S: Final = 0.01


class Visitor(Membership):
    """A node in the domain for one command, whose process cancels our wait by closing our stdin."""

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, f"{LOOK_NODE}{os.getpid()}")

    def settle(self) -> None:
        """Wait until every process in the domain is discovered, at most SETTLE_S after joining."""
        self.discover(lambda: False)

    def discover(self, is_known: Callable[[], bool], *, expected: bool = False) -> bool:
        """Wait until `is_known()` is true, and return True; return False if the wait ends earlier.

        The wait ends SETTLE_S after the domain was joined, or as soon as discovery is complete or
        no other process is there. If `expected` is true, it ends only after EXPECTED_S.

        Raises:
            asyncio.CancelledError: Stdin was closed: the command has ended.
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
