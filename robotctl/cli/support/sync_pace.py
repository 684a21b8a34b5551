"""How fast `sync` may go: a limit of the bandwidth, and a pause while the robot moves."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import Final, Self

from robotctl.collect.bandwidth import Bandwidth
from robotctl.errors import Interrupted, NoDaemon, RobotctlError
from robotctl.ipc.client import NoAnswer, call
from robotctl.ipc.method_names import STATUS

_BITS: Final = 8e-6
"""Megabits of a byte."""

_LOOK_EACH_S: Final = 1.0
_ANSWER_S: Final = 2.0


class SyncPace:
    """Waits before each piece, in whatever thread; the end of the `with` block ends a wait."""

    def __init__(self, limit_mbps: float | None, robot: str | None) -> None:
        """`limit_mbps` in megabits per second; None for no limit, and for no robot to wait for."""
        now_s = time.monotonic()
        self._bandwidth = None if limit_mbps is None else Bandwidth(limit_mbps / _BITS, now_s)
        self._robot = robot
        self._ended = threading.Event()
        self._look_s = now_s
        """When to look next whether the robot moves."""

    def __enter__(self) -> Self:
        """Ask the daemon once.

        Raises:
            RobotctlError: It cannot be asked, so its robot could move at any time.
        """
        if self._robot is not None:
            with suppress(NoDaemon):
                _is_moving(self._robot)
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def __call__(self, count: int) -> None:
        """Wait until this number of bytes may be sent; with 0, until the robot does not move.

        Raises:
            Interrupted: The block has ended.
        """
        if self._robot is not None and time.monotonic() >= self._look_s:
            while _may_be_moving(self._robot):
                self._wait(_LOOK_EACH_S)
            self._look_s = time.monotonic() + _LOOK_EACH_S
        if self._bandwidth is not None:
            self._wait(self._bandwidth.delay_s(count, time.monotonic()))

    def _wait(self, seconds: float) -> None:
        if self._ended.wait(seconds):
            raise Interrupted


def _may_be_moving(robot: str) -> bool:
    """Return whether the robot moves; one with a daemon that does not tell may move."""
    try:
        return _is_moving(robot)
    except NoDaemon as error:
        return isinstance(error, NoAnswer)
    except RobotctlError:
        return True


def _is_moving(robot: str) -> bool:
    return call(robot, STATUS, deadline_s=_ANSWER_S)["mode"] == "MOVING"
