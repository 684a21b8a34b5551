"""Checks of the ROS graph: the topics of command and odometry, and the types of all topics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import Final

from robotctl.doctor.machine import Finding, fault, ok, warning
from robotctl.ipc.answers import GraphEndpoint, GraphTopic, NameAndTypes
from robotctl.kernel.constants import TWIST, TWIST_STAMPED
from robotctl.messages.cdr import ODOMETRY
from robotctl.messages.installed import NOT_INSTALLED, installed_type

ODOMETRY_TYPES: Final = (ODOMETRY,)
COMMAND_TYPES: Final = (TWIST, TWIST_STAMPED)

_UNMATCHED: Final = (
    ("reliability", "best_effort", "reliable"),
    ("durability", "volatile", "transient_local"),
)
"""A QoS policy, an offered value, and the requested value that such a publisher does not match."""

MAX_NAMED: Final = 5

MAX_ENDPOINTS: Final = 200
"""Limit on the endpoints that are compared in pairs: a process may announce any number."""


def check_command(topic: GraphTopic, *, has_odometry: bool) -> Iterator[Finding]:
    """Check the command topic; with `has_odometry`, a topic without subscribers is a fault."""
    yield from _check_topic("command", topic, COMMAND_TYPES)
    listeners = [each for each in topic["subscriptions"] if "/_" not in each["node"]]  # not hidden
    if has_odometry and not listeners:
        yield fault(
            "command",
            f"odometry arrives, but no node subscribes to {topic['name']}",
            "compare command.topic with the topic of the base: robotctl topic list -t",
        )
    if len(topic["publishers"]) > 1:
        yield warning(
            "command",
            f"{_names(topic['publishers'])} publish {topic['name']}: they overrule each other",
            "end all but one, or put a twist_mux between",
        )


def check_odometry(topic: GraphTopic) -> Iterator[Finding]:
    """Check the odometry topic: its types, its QoS, and that it has at most one publisher."""
    yield from _check_topic("odometry", topic, ODOMETRY_TYPES)
    if len(topic["publishers"]) > 1:
        yield fault(
            "odometry",
            f"{_names(topic['publishers'])} publish {topic['name']}: robotctl uses the first",
            "end all but one: a second driver, a simulator, or a bag that is played",
        )


def check_definitions(topics: Sequence[NameAndTypes]) -> Iterator[Finding]:
    """Report the topics whose message type is not installed here."""
    types = {kind: each["name"] for each in topics for kind in each["types"]}
    missing = {kind: types[kind] for kind in types if installed_type(kind) == NOT_INSTALLED}
    if missing:
        shown = [f"{kind} (of {name})" for kind, name in sorted(missing.items())]
        more = f" and {len(shown) - MAX_NAMED} more" if len(shown) > MAX_NAMED else ""
        yield warning(
            "message types",
            f"no definition here of {', '.join(shown[:MAX_NAMED])}{more}: they are not recorded",
            "install their packages, or source the workspace that has them",
        )
    else:
        yield ok("message types", f"every type of {len(topics)} topics is installed")


def _check_topic(check: str, topic: GraphTopic, wanted: tuple[str, ...]) -> Iterator[Finding]:
    publishers, subscriptions = topic["publishers"], topic["subscriptions"]
    if len(topic["types"]) > 1:
        users = [*publishers, *subscriptions]
        each_type = "; ".join(
            f"{kind} by {_names([each for each in users if each['type'] == kind])}"
            for kind in topic["types"]
        )
        cure = "give all of them one type, for the command by command.stamped"
        yield fault(check, f"{topic['name']} has several types, {each_type}", cure)
    elif topic["types"] and topic["types"][0] not in wanted:
        text = f"{topic['name']} has type {topic['types'][0]}, not {' or '.join(wanted)}"
        yield fault(check, text, f"set {check}.topic to the right topic")
    pairs = (
        _check_pair(check, topic["name"], publisher, subscription)
        for publisher in publishers[:MAX_ENDPOINTS]
        for subscription in subscriptions[:MAX_ENDPOINTS]
        if publisher["type"] == subscription["type"]
    )
    yield from islice(chain.from_iterable(pairs), MAX_NAMED)
    if publishers or subscriptions:
        counts = f"{len(publishers)} publishers, {len(subscriptions)} subscriptions"
        yield ok(check, f"{topic['name']} ({', '.join(topic['types'])}): {counts}")
    else:
        yield ok(check, f"no node uses {topic['name']} yet")


def _check_pair(
    check: str, topic: str, publisher: GraphEndpoint, subscription: GraphEndpoint
) -> Iterator[Finding]:
    for policy, offered, asked in _UNMATCHED:
        if publisher["qos"][policy] == offered and subscription["qos"][policy] == asked:
            yield fault(
                check,
                f"{_name(subscription)} hears nothing of {_name(publisher)} on {topic}: "
                f"{policy} {offered} is offered, {asked} asked for",
                f"let {_name(subscription)} ask for {offered}, or {_name(publisher)} offer {asked}",
            )


def _names(endpoints: Sequence[GraphEndpoint]) -> str:
    names = sorted({_name(each) for each in endpoints})
    more = [f"{len(names) - MAX_NAMED} more"] if len(names) > MAX_NAMED else []
    return " and ".join([*names[:MAX_NAMED], *more])


def _name(endpoint: GraphEndpoint) -> str:
    return endpoint["node"] or "a node without a known name"
