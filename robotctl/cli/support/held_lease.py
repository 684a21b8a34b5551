"""Hold the lease of a robot during a `with` block, and keep it alive meanwhile."""

from __future__ import annotations

import secrets
import signal
import threading
import time
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import Self

from robotctl.cli.support.background import Background
from robotctl.cli.support.interrupted_drive import CLOSING_SIGNALS, POLL_S
from robotctl.cli.support.quick_actions import request_source
from robotctl.cli.support.signals import ignoring
from robotctl.errors import RobotctlError
from robotctl.ipc.answers import LeaseAnswer
from robotctl.ipc.client import Client, call
from robotctl.ipc.method_names import LEASE_KEEP, LEASE_RELEASE, LEASE_TAKE

KEEP_S = 0.2
"""Period in which the daemon hears that this process still runs."""


class HeldLease:
    """The lease, from the beginning of the block to its end; other clients cannot start motion.

    A process that is frozen or killed loses it within about a second, and the robot ramps down.

    Raises:
        Refused: Another client holds the lease, or the robot moves already.
        NoDaemon: No daemon runs.
    """

    def __init__(self, robot: str, command: str, reason: str = "") -> None:
        """`command` is the name of the command of robotctl that takes the lease."""
        self.token = secrets.token_hex(16)
        """What a request carries that acts for the holder (parameter `lease`)."""
        self._robot = robot
        self._source = request_source(command)
        params = {"token": self.token, "source": self._source, "reason": reason}
        self._holding: Background[LeaseAnswer] = Background(
            partial(call, robot, LEASE_TAKE, params, deadline_s=None)
        )
        self._ended = threading.Event()

    @property
    def is_over(self) -> bool:
        """Whether the lease has ended."""
        return self._holding.is_done

    def result(self) -> LeaseAnswer:
        """Return how the lease ended.

        Raises:
            RobotctlError: It was refused or lost.
        """
        return self._holding.result()

    def __enter__(self) -> Self:
        """Take the lease; return once it is held."""
        try:
            self._holding.start()
            with Client(self._robot) as client:
                while not client.call(LEASE_KEEP, {"token": self.token})["yours"]:
                    if self.is_over:
                        self.result()
                    time.sleep(POLL_S)
        except BaseException:
            self._release()
            raise
        Background(self._keep).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._release()

    def _keep(self) -> None:
        with Client(self._robot) as client:
            while not self._ended.wait(KEEP_S):
                if not client.call(LEASE_KEEP, {"token": self.token})["yours"]:
                    return

    def _release(self) -> None:
        self._ended.set()
        if not self.is_over and self._holding.ident is not None:
            params = {"token": self.token, "source": self._source}
            # The end of the connection releases it too: whatever fails here is told by `result`.
            with ignoring((signal.SIGINT, *CLOSING_SIGNALS)), suppress(RobotctlError):
                call(self._robot, LEASE_RELEASE, params)
