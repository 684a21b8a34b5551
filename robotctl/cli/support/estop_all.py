"""The emergency stop of several robots, and who moves on after the stop of one."""

from __future__ import annotations

from typing import TypedDict

from robotctl.cli.support import robots
from robotctl.errors import NoDaemon, RobotctlError
from robotctl.ipc.client import call
from robotctl.ipc.method_names import SET_MODE
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE


class StoppedRobot(TypedDict):
    """What became of the stop of one robot; `message` is why it failed if it did."""

    robot: str
    ok: bool
    message: str


def stop_all(params: dict[str, str]) -> tuple[list[StoppedRobot], RobotctlError | None]:
    """Stop every robot at the same time; return what became of it, and the first failure.

    Raises:
        NoDaemon: There is no daemon.
    """
    failures: list[RobotctlError] = []

    def stop(robot: str) -> StoppedRobot | None:
        try:
            answer = call(robot, SET_MODE, {"mode": EMERGENCY_STOP_MODE, **params})
        except NoDaemon as error:
            if not any(each.robot == robot for each in robots.find([robot])):
                return None
            return _failed(robot, error)
        except RobotctlError as error:
            return _failed(robot, error)
        return {"robot": robot, "ok": True, "message": answer["message"]}

    def _failed(robot: str, error: RobotctlError) -> StoppedRobot:
        failures.append(error)
        return {"robot": robot, "ok": False, "message": str(error)}

    stopped = [each for each in robots.at_once(stop, robots.names()) if each is not None]
    if not stopped:
        raise NoDaemon("no daemon runs: nothing was stopped")
    return stopped, failures[0] if failures else None


def others_than(robot: str) -> list[robots.RobotDaemon]:
    """Return the other robots that move, or do not say whether they do."""
    others = [name for name in robots.names() if name != robot]
    return [found for found in robots.find(others) if found.moves or found.problem]
