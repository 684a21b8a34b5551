"""The daemons of this user, as far as a replay could get in their way."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.errors import NoDaemon, RobotctlError, UsageError
from robotctl.ipc.client import Client
from robotctl.paths import chain_to, runtime_folder
from robotctl.replay.job import Job

ANSWER_DEADLINE_S = 2.0


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """A daemon that listens; `domain_id` and `mode` are None where it did not tell them."""

    robot: str
    domain_id: int | None
    mode: str | None
    observes: bool = False
    """It only records, and so is in nobody's way."""

    @property
    def may_be_moving(self) -> bool:
        """Whether it drives, or may do so for all that is known."""
        return self.mode in (None, "MOVING")


def running_daemons() -> list[RunningDaemon]:
    """Every daemon that listens on a control socket of this user, by name.

    Raises UsageError if another user could have put the sockets there.
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
    """Those that drive in a ROS domain; one that does not say where it is may be there."""
    return [
        daemon
        for daemon in running_daemons()
        if daemon.domain_id in (None, domain_id) and not daemon.observes
    ]


def domain_of(job: Job) -> int:
    """The domain that a job asks for, else that of the robot's daemon, else 0."""
    if job.domain_id is not None:
        return job.domain_id
    daemon = ask(job.robot)
    return 0 if daemon is None else daemon.domain_id or 0


def ask(robot: str) -> RunningDaemon | None:
    """The robot's daemon, or None where nobody listens.

    Raises Refused where another user's process listens in its place.
    """
    try:
        with Client(robot) as client:
            try:
                status = client.call("status", deadline_s=ANSWER_DEADLINE_S)
            except RobotctlError:  # it is there, but slow, busy or of another version
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
