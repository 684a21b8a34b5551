"""What of a recording is played, under which names, and what is held back for safety."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

from robotctl.errors import Refused, UsageError
from robotctl.ipc.client import command_for
from robotctl.recording.reader import TopicInfo
from robotctl.replay.neighbours import Daemon

REPLAY_PREFIX = "/replay"
"""Where a replay goes that must not be mistaken for the robot."""

COMMAND_TYPES = frozenset({"geometry_msgs/msg/Twist"})
COMMAND_NAME = "cmd_vel"
"""What moves robots: a Twist under any name, and whatever is published as `.../cmd_vel`."""

MAX_NAMES_SHOWN = 12


@dataclass(frozen=True, slots=True)
class Route:
    """A recorded topic and the name under which it is published."""

    topic: TopicInfo
    name: str


def published_name(topic: str, prefix: str) -> str:
    """The name of a recorded topic below `prefix`; always absolute."""
    return f"{prefix}/{topic.lstrip('/')}"


def selected(
    recorded: Sequence[TopicInfo], topics: Collection[str], exclude: Collection[str]
) -> list[TopicInfo]:
    """The topics to play. Raises UsageError for a name in `topics` that is not in the recording."""
    wanted, unwanted = ({published_name(name, "") for name in names} for names in (topics, exclude))
    there = {published_name(topic.name, "") for topic in recorded}
    absent = sorted(wanted - there)
    if absent:
        names = ", ".join(sorted(there)[:MAX_NAMES_SHOWN]) or "no topics"
        raise UsageError(f"--topics {', '.join(absent)}: not in the recording, which has {names}")
    return [
        topic
        for topic in recorded
        if (not wanted or published_name(topic.name, "") in wanted)
        and published_name(topic.name, "") not in unwanted
    ]


def unplayable(topics: Iterable[TopicInfo]) -> dict[str, str]:
    """Topics that cannot be played whatever is installed, and why."""
    topics = list(topics)
    types = Counter(topic.name for topic in topics)
    reasons = {}
    for topic in topics:
        if types[topic.name] > 1:
            reasons[topic.name] = "is recorded with several types"
        elif topic.encoding != "cdr":
            reasons[topic.name] = f"is encoded as {topic.encoding or 'nothing known'}, not as cdr"
        elif not topic.type_name:
            reasons[topic.name] = "has no type in the file"
    return reasons


def prefix_for(daemons: Sequence[Daemon], domain_id: int, *, force: bool) -> tuple[str, str]:
    """The prefix of all names, and a sentence about it ("" where there is nothing to say).

    Raises:
        Refused: `force`, while a daemon moves its robot, or may do so.
    """
    if not daemons:
        return "", ""
    names = ", ".join(repr(daemon.robot) for daemon in daemons)
    who = f"a daemon ({names}) runs in ROS domain {domain_id}"
    if not force:
        return REPLAY_PREFIX, (
            f"{who}: everything is published below {REPLAY_PREFIX} "
            "(the original names: --force; another domain: --domain-id)"
        )
    check_still(daemons)
    return "", f"{who}: --force publishes the original names all the same"


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


def is_command(topic: TopicInfo) -> bool:
    """Whether a robot may move by it."""
    return topic.type_name in COMMAND_TYPES or topic.name.rpartition("/")[2] == COMMAND_NAME


def withheld_commands(
    routes: Iterable[Route], named: Collection[str], count_subscribers: Callable[[str], int]
) -> list[Route]:
    """The commands that somebody would obey and nobody asked for by name."""
    asked_for = {published_name(name, "") for name in named}
    return [
        route
        for route in routes
        if is_command(route.topic)
        and published_name(route.topic.name, "") not in asked_for
        and count_subscribers(route.name)
    ]
