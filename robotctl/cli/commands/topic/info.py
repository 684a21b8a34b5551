"""topic info: who publishes a topic and who subscribes to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import typer

from robotctl.cli.commands.topic.options import TopicName
from robotctl.cli.options import DomainId, Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.ros_view import ros_view
from robotctl.cli.terminal.text import printable
from robotctl.ipc.answers import GraphEndpoint, GraphTopic
from robotctl.paths import DEFAULT_ROBOT


def info(
    topic: TopicName,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="Also node, type, gid and QoS of each.")
    ] = False,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Show the type of a topic, and the number of its publishers and subscriptions.

    \b
    Examples:
      robotctl topic info /cmd_vel -v
    """
    view = ros_view(robot, domain_id)
    found = view.topic(view.full_name(topic))
    print_answer(found, _lines(found, verbose=verbose), as_json=as_json)


def _lines(found: GraphTopic, *, verbose: bool) -> Iterator[str]:
    yield f"Type: {', '.join(map(printable, found['types']))}"
    for title, endpoints in (
        ("Publisher", found["publishers"]),
        ("Subscription", found["subscriptions"]),
    ):
        yield f"{title} count: {len(endpoints)}"
        if verbose:
            yield from _endpoint_lines(endpoints)


def _endpoint_lines(endpoints: Sequence[GraphEndpoint]) -> Iterator[str]:
    for each in endpoints:
        known = {name: value for name, value in each["qos"].items() if value not in ("unknown", 0)}
        qos = ", ".join(f"{name} {value}" for name, value in known.items())
        yield f"  {printable(each['node']) or 'a node without a known name'}"
        yield f"    type {printable(each['type'])}"
        yield f"    gid  {each['gid']}"
        yield f"    qos  {qos}"
