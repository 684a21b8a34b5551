"""The membership in a ROS domain of a process that answers one command."""

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
"""Readable only when the command has closed it, because the command sends a single line."""

SETTLE_S: Final = 3.5
"""How long discovery may take: an announcement that was lost is repeated after 3 s."""

EXPECTED_S: Final = 20.0
"""How long the discovery of a name may take that the daemon has already discovered."""

QUIET_S: Final = 0.1
"""The graph counts as discovered when it has not changed for this time."""

_POLL_S: Final = 0.01


class Visitor(Membership):
    """A membership for one command; its waits are cancelled when the command closes stdin."""

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, f"{LOOK_NODE}{os.getpid()}")

    def settle(self) -> None:
        """Wait until every process in the domain is discovered, at most SETTLE_S after joining."""
        self.discover(lambda: False)

    def discover(self, is_known: Callable[[], bool], *, expected: bool = False) -> bool:
        """Wait until `is_known()`, and return whether it is.

        The wait lasts until discovery is complete, at most SETTLE_S; if `expected`, EXPECTED_S.

        Raises:
            asyncio.CancelledError: The asking command has ended: it closed stdin.
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
