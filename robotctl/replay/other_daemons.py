"""Finds the running daemons of this user, which a replay could disturb."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.errors import NoDaemon, RobotctlError, UsageError
from robotctl.ipc.client import Client
from robotctl.paths import chain_to, runtime_folder

ANSWER_DEADLINE_S = 2.0


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """A daemon that listens; `domain_id` and `mode` are None if unknown."""

    robot: str
    domain_id: int | None
    mode: str | None
    observes: bool = False
    """Whether it only records, so that a replay cannot disturb it."""

    @property
    def may_be_moving(self) -> bool:
        """Whether it drives, or may do so because its mode is unknown."""
        return self.mode in (None, "MOVING")


def running_daemons() -> list[RunningDaemon]:
    """Return each daemon with a control socket of this user, ordered by name.

    Raises:
        UsageError: Another user could have put the sockets there.
    """
    folder = runtime_folder()
    chain_to(folder).for_client().check()
    found = []
    for path in sorted(folder.glob("*.sock")):
        daemon = ask(path.stem)
        if daemon is not None:
            found.append(daemon)
    return found


def daemons_in(domain_id: int) -> list[RunningDaemon]:
    """Return the driving daemons in a ROS domain, including those whose domain is unknown."""
    return [
        daemon
        for daemon in running_daemons()
        if daemon.domain_id in (None, domain_id) and not daemon.observes
    ]


def domain_to_play_in(requested: int | None, robot: str) -> int:
    """Return the requested domain, else that of the robot's daemon, else 0."""
    if requested is not None:
        return requested
    daemon = ask(robot)
    return 0 if daemon is None else daemon.domain_id or 0


def ask(robot: str) -> RunningDaemon | None:
    """Return the robot's daemon, or None if none listens.

    Raises:
        Refused: A process of another user listens in its place.
    """
    try:
        with Client(robot) as client:
            try:
                status = client.call("status", deadline_s=ANSWER_DEADLINE_S)
            except RobotctlError:  # it is running, but slow, busy or of another version
                return RunningDaemon(robot, None, None)
    except (NoDaemon, UsageError):
        return None
    domain_id, mode = status.get("domain_id"), status.get("mode")
    return RunningDaemon(
        robot,
        domain_id if isinstance(domain_id, int) else None,
        mode if isinstance(mode, str) else None,
        observes="mode" in status and mode is None,
    )
