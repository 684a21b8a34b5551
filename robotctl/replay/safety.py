"""What keeps a replay from being mistaken for the robot, and a robot from obeying it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import Final, Protocol

from robotctl.errors import Refused
from robotctl.ipc.client import command_for
from robotctl.replay.neighbours import Daemon, daemons_in
from robotctl.replay.plan import Route, absolute, is_named

REPLAY_PREFIX: Final = "/replay"
"""Where a replay goes that must not be mistaken for the robot."""

COMMAND_TYPES: Final = frozenset({"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"})
COMMAND_NAME: Final = "cmd_vel"
"""What moves robots: a Twist under any name, and whatever is published as `.../cmd_vel`."""


class Graph(Protocol):
    """Who is in the ROS domain."""

    def robots_with_daemon(self) -> list[str]:
        """The names of the robots whose daemons are in the domain, whoever runs them."""

    def count_subscribers(self, topic: str) -> int:
        """How many subscribe to the topic."""

    def count_servers(self, service: str) -> int:
        """How many serve the service."""


class Safety:
    """The rules for one replay in one domain; `named` are the topics that the user asked for."""

    def __init__(
        self, graph: Graph, domain_id: int, named: Collection[str], *, force: bool
    ) -> None:
        self.prefix = ""
        self._graph = graph
        self._domain_id = domain_id
        self._named = named
        self._force = force
        self._beside_daemon = False

    def choose_prefix(self) -> str:
        """Choose the prefix of all names; returns a sentence about it, "" where all is as usual.

        Raises:
            Refused: `force`, while a daemon moves its robot, or may do so.
        """
        daemons = self._daemons()
        if not daemons:
            return ""
        self._beside_daemon = True
        who = f"a daemon ({_names_of(daemons)}) runs in ROS domain {self._domain_id}"
        if self._force:
            check_still(daemons)
            return f"{who}: --force publishes the original names all the same"
        self.prefix = REPLAY_PREFIX
        return (
            f"{who}: everything is published below {REPLAY_PREFIX} "
            "(the original names: --force; another domain: --domain-id)"
        )

    def prefixed(self, routes: Iterable[Route]) -> list[Route]:
        """The routes with the prefix that was chosen."""
        return [replace(route, name=absolute(route.name, self.prefix)) for route in routes]

    def withheld(self, routes: Iterable[Route]) -> list[Route]:
        """What a robot would obey and nobody asked for by name; call it again and again.

        Below the prefix there is none, and with `force` beside a daemon that is what is wanted.
        """
        if self.prefix or (self._force and self._beside_daemon):
            return []
        return [
            route
            for route in routes
            if is_command(route)
            and not is_named(route.topic, self._named)
            and self._would_be_obeyed(route)
        ]

    def check(self) -> None:
        """Raise Refused where a daemon has come, or begun to move; call it again and again."""
        if self.prefix:
            return
        daemons = self._daemons()
        if self._force:
            check_still(daemons)
        elif daemons:
            raise Refused(
                f"a daemon ({_names_of(daemons)}) has come into ROS domain {self._domain_id}: the "
                "replay under the original names has ended "
                f"(start it again to play below {REPLAY_PREFIX})"
            )

    def _daemons(self) -> list[Daemon]:
        """Our own, who can be asked, and those that only the ROS graph shows."""
        daemons = daemons_in(self._domain_id)
        known = {daemon.robot for daemon in daemons}
        others = [
            Daemon(robot, self._domain_id, None) for robot in self._graph.robots_with_daemon()
        ]
        return daemons + [daemon for daemon in others if daemon.robot not in known]

    def _would_be_obeyed(self, route: Route) -> int:
        graph = self._graph
        count = graph.count_servers if route.requests else graph.count_subscribers
        return count(route.name)


def check_still(daemons: Iterable[Daemon]) -> None:
    """Raise Refused if one of the daemons moves its robot, or may do so."""
    for daemon in daemons:
        if daemon.may_be_moving:
            state = daemon.mode or "in a mode that it does not tell"
            cure = command_for(daemon.robot, "set-mode idle")
            raise Refused(
                f"--force is refused while robot {daemon.robot!r} is {state}: a replay under the "
                f"original names would mislead it (first: {cure})"
            )


def is_command(route: Route) -> bool:
    """Whether a robot may move by it, as it was recorded or as it is called now."""
    names = (route.topic.name, route.name)
    return (
        route.requests
        or route.topic.type_name in COMMAND_TYPES
        or any(name.rpartition("/")[2] == COMMAND_NAME for name in names)
    )


def withheld_note(route: Route) -> str:
    """A sentence about a route that is withheld."""
    name = route.topic.name
    does = "serves it" if route.requests else "subscribes to it"
    return (
        f"{name} is withheld: somebody {does}, and a robot would obey "
        f"(to send it nevertheless, name it: --topics {name})"
    )


def _names_of(daemons: Sequence[Daemon]) -> str:
    return ", ".join(repr(daemon.robot) for daemon in daemons)
