"""Safety rules: a replay must not be mistaken for the robot, and no robot must obey it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

from robotctl.base.errors import NoDaemon, Refused, RobotctlError, UsageError
from robotctl.base.paths import chain_to, runtime_folder
from robotctl.ipc.client import Client, command_for
from robotctl.kernel.constants import COMMAND_TYPES
from robotctl.replay.plan import Route, absolute, is_named

ANSWER_DEADLINE_S = 2.0


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """A daemon that listens on its socket. `domain_id` and `mode` are None if unknown."""

    robot: str
    domain_id: int | None
    mode: str | None
    observes: bool = False
    """Whether the daemon only records, so that a replay cannot disturb it."""

    @property
    def may_be_moving(self) -> bool:
        """Whether the robot is moving, or its mode is unknown."""
        return self.mode in (None, "MOVING")


def running_daemons() -> list[RunningDaemon]:
    """Return each daemon with a socket in this user's runtime folder, ordered by name.

    Raises:
        UsageError: Another user could change the folder.
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
    """Return the daemons whose domain is `domain_id` or unknown, but none that only records."""
    return [
        daemon
        for daemon in running_daemons()
        if daemon.domain_id in (None, domain_id) and not daemon.observes
    ]


def domain_to_play_in(requested: int | None, robot: str) -> int:
    """Return `requested` or, if it is None, the domain of the robot's daemon, or 0 if unknown.

    Raises:
        Refused: A process of another user listens in place of the daemon.
    """
    if requested is not None:
        return requested
    daemon = ask(robot)
    return 0 if daemon is None else daemon.domain_id or 0


def ask(robot: str) -> RunningDaemon | None:
    """Return the robot's daemon with its domain and mode, or None if no daemon can be reached.

    Raises:
        Refused: A process of another user listens in the daemon's place.
    """
    try:
        with Client(robot) as client:
            try:
                status = client.call("status", deadline_s=ANSWER_DEADLINE_S)
            except RobotctlError:  # the daemon runs, but is slow, busy or of another version
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


REPLAY_PREFIX: Final = "/replay"
"""The prefix of all topics of a replay in a domain with a daemon."""

COMMAND_NAME: Final = "cmd_vel"
"""The last part of a command topic's name, whatever its type."""


class DomainGraph(Protocol):
    """The part of the ROS graph that ReplayGuard needs."""

    def robots_with_daemon(self) -> list[str]:
        """Return the names of the robots whose daemons, of any user, are in the domain."""


class ReplayGuard:
    """Applies the safety rules to one replay. `named` has the topics of --topics."""

    def __init__(
        self, graph: DomainGraph, domain_id: int, named: Collection[str], *, original_names: bool
    ) -> None:
        self.prefix = ""
        self._graph = graph
        self._domain_id = domain_id
        self._named = named
        self._original_names = original_names

    def choose_prefix(self) -> str:
        """Choose the prefix of all topic names. Return a note for the user, "" if no daemon runs.

        Raises:
            Refused: --original-names was given, but the robot of a daemon is or may be moving.
        """
        daemons = self._daemons()
        if not daemons:
            return ""
        who = f"a daemon ({_names_of(daemons)}) runs in ROS domain {self._domain_id}"
        if self._original_names:
            check_still(daemons)
            return f"{who}: --original-names publishes the recorded names in the same domain"
        self.prefix = REPLAY_PREFIX
        return (
            f"{who}: everything is published below {REPLAY_PREFIX} "
            "(the original names: --original-names; another domain: --domain-id)"
        )

    def prefixed(self, routes: Iterable[Route]) -> list[Route]:
        """Return the routes with the chosen prefix before their names."""
        return [replace(route, name=absolute(route.name, self.prefix)) for route in routes]

    def withheld(self, routes: Iterable[Route]) -> list[Route]:
        """Return the routes that a robot would obey, except those in --topics; none if prefixed."""
        if self.prefix:
            return []
        return [route for route in routes if is_command(route) and not self.names(route)]

    def names(self, route: Route) -> bool:
        """Return whether the user named the topic of the route, or its service."""
        return is_named(route.topic, self._named)

    def check(self) -> None:
        """Check that the replay is still safe. Call this repeatedly.

        Raises:
            Refused: A daemon has joined or, with --original-names, a robot is or may be moving.
        """
        if self.prefix:
            return
        daemons = self._daemons()
        if self._original_names:
            check_still(daemons)
        elif daemons:
            raise Refused(
                f"a daemon ({_names_of(daemons)}) has joined ROS domain {self._domain_id}: the "
                "replay under the original names has ended "
                f"(start it again to play below {REPLAY_PREFIX})"
            )

    def _daemons(self) -> list[RunningDaemon]:
        """Return the domain's daemons with a socket on this machine, and the others on ROS."""
        daemons = daemons_in(self._domain_id)
        known = {daemon.robot for daemon in daemons}
        others = [
            RunningDaemon(robot, self._domain_id, None)
            for robot in self._graph.robots_with_daemon()
        ]
        return daemons + [daemon for daemon in others if daemon.robot not in known]


def check_still(daemons: Iterable[RunningDaemon]) -> None:
    """Check that no robot of `daemons` is moving.

    Raises:
        Refused: A robot is or may be moving.
    """
    for daemon in daemons:
        if daemon.may_be_moving:
            state = daemon.mode or "in an unknown mode"
            cure = command_for(daemon.robot, "set-mode idle")
            raise Refused(
                f"--original-names is refused while robot {daemon.robot!r} is {state}: the replay "
                f"would mislead it (first: {cure})"
            )


def is_command(route: Route) -> bool:
    """Return whether a route may move a robot: a service, or a command by type or name."""
    names = (route.topic.name, route.name)
    return (
        route.requests
        or route.topic.type_name in COMMAND_TYPES
        or any(name.rpartition("/")[2] == COMMAND_NAME for name in names)
    )


def withheld_note(route: Route) -> str:
    """Return the note for the user about a withheld route."""
    name = route.topic.name
    what = "requests" if route.requests else "commands"
    return f"{name} is withheld: a robot would obey these {what} (send them: --topics {name})"


def _names_of(daemons: Sequence[RunningDaemon]) -> str:
    return ", ".join(repr(daemon.robot) for daemon in daemons)
