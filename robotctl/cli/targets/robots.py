"""Find all daemons of this user by the sockets in the runtime folder, and stop their robots."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple, TypeVar

from robotctl.base.errors import NoDaemon, Refused, RobotctlError
from robotctl.base.paths import runtime_folder
from robotctl.cli.targets.driving import Background
from robotctl.ipc.answers import Status
from robotctl.ipc.client import Client, call
from robotctl.ipc.method_names import SET_MODE, STATUS
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

SUFFIX = ".sock"

ANSWER_S = 2.0
"""The timeout of a daemon's status [s]."""

T = TypeVar("T")


class RobotDaemon(NamedTuple):
    """A running daemon; without a `status`, `problem` is the reason."""

    robot: str
    status: Status | None
    problem: str

    @property
    def moves(self) -> bool:
        """Whether the daemon's last status has the mode MOVING; False without a status."""
        return self.status is not None and self.status["mode"] == "MOVING"


def names() -> list[str]:
    """Return the robots with a socket, even if a killed daemon left it.

    Raises:
        Refused: The runtime folder belongs to another user.
    """
    folder = runtime_folder()
    try:
        found = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except PermissionError:
        raise Refused(f"{folder} belongs to another user") from None
    return sorted(name.removesuffix(SUFFIX) for name in found if name.endswith(SUFFIX))


def find(robots: Iterable[str]) -> list[RobotDaemon]:
    """Return each running daemon of `robots`."""
    return [found for found in at_once(_look, robots) if found is not None]


def at_once(ask: Callable[[str], T], robots: Iterable[str]) -> list[T]:
    """Call `ask` for all robots in parallel, and return the results in the order of `robots`."""
    asking = [Background(partial(ask, robot)) for robot in robots]
    for each in asking:
        each.start()
    return [each.result() for each in asking]


def _look(robot: str) -> RobotDaemon | None:
    try:
        with Client(robot) as client:
            try:
                return RobotDaemon(robot, client.call(STATUS, deadline_s=ANSWER_S), "")
            except RobotctlError as error:
                return RobotDaemon(robot, None, str(error))
    except NoDaemon:
        return None
    except RobotctlError as error:
        return RobotDaemon(robot, None, str(error))


def stop_all(params: dict[str, str]) -> tuple[list[dict[str, Any]], RobotctlError | None]:
    """Latch the emergency stop of all robots in parallel; return all results and the first error.

    A result has the keys `robot`, `ok` and `message`. A robot without a daemon is left out.

    Raises:
        NoDaemon: There is no daemon.
    """
    failures: list[RobotctlError] = []

    def stop(robot: str) -> dict[str, Any] | None:
        try:
            answer = call(robot, SET_MODE, {"mode": EMERGENCY_STOP_MODE, **params})
        except NoDaemon as error:
            if not any(each.robot == robot for each in find([robot])):
                return None
            return _failed(robot, error)
        except RobotctlError as error:
            return _failed(robot, error)
        return {"robot": robot, "ok": True, "message": answer["message"]}

    def _failed(robot: str, error: RobotctlError) -> dict[str, Any]:
        failures.append(error)
        return {"robot": robot, "ok": False, "message": str(error)}

    stopped = [each for each in at_once(stop, names()) if each is not None]
    if not stopped:
        raise NoDaemon("no daemon runs: nothing was stopped")
    return stopped, failures[0] if failures else None


def others_than(robot: str) -> list[RobotDaemon]:
    """Return the daemons of all other robots that move, or whose status is unknown."""
    others = [name for name in names() if name != robot]
    return [found for found in find(others) if found.moves or found.problem]
