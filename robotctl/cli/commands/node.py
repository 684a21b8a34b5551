"""node, service: nodes and services of the ROS graph."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from typing import Annotated, Any

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import All, DomainId, Json, Robot, Types, new_app, new_group
from robotctl.cli.targets.ros_view import ros_view
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.ros_text import (
    is_hidden,
    message_lines,
    plain_json,
    print_names,
)
from robotctl.cli.ui.text import printable
from robotctl.ipc.answers import GraphNode

app = new_app()
node_group = new_group(app, "node")

_SECTIONS = {
    "subscriptions": "Subscribers",
    "publishers": "Publishers",
    "servers": "Service Servers",
    "clients": "Service Clients",
}


@node_group.callback()
def node() -> None:
    """Show the nodes on ROS, and what each one does there.

    \b
    Examples:
      robotctl node list
      robotctl node info /mode_service
    """


@node_group.command("list")
def list_nodes(
    every: All = False,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """List the nodes on ROS; a name appears twice if two nodes have it.

    \b
    Examples:
      robotctl node list
    """
    print_names(ros_view(robot, domain_id).names(), "nodes", every=every, as_json=as_json)


@node_group.command()
def info(
    name: Annotated[
        str, typer.Argument(metavar="NODE", help="The node; without a leading / the robot's.")
    ],
    every: All = False,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Show the topics, services and actions of a node.

    \b
    Examples:
      robotctl node info /mode_service
    """
    view = ros_view(robot, domain_id)
    found = view.node(view.full_name(name))
    print_answer(found, _lines(found, every=every), as_json=as_json)


def _lines(found: GraphNode, *, every: bool) -> Iterator[str]:
    yield printable(found["name"])
    for key, title in _SECTIONS.items():
        yield f"  {title}:"
        for each in found[key]:  # type: ignore[literal-required]
            if every or not is_hidden(each["name"]):
                yield f"    {printable(each['name'])}: {', '.join(map(printable, each['types']))}"
    for title, key in (("Action Servers", "servers"), ("Action Clients", "clients")):
        yield f"  {title}:"
        for each in found[key]:  # type: ignore[literal-required]
            action, _, service = each["name"].partition("/_action/")
            if service == "send_goal":
                types = ", ".join(each["types"]).replace("_SendGoal", "")
                yield f"    {printable(action)}: {printable(types)}"


service_group = new_group(app, "service")


@service_group.callback()
def service() -> None:
    """Show the services on ROS, and call them.

    \b
    Examples:
      robotctl service list -t
      robotctl service call /set_mode "{requested_mode: 1}"
    """


SERVICE_S = 5.0
"""The timeout of the search for the service [s]."""

_TYPE = re.compile(r"\w+/(?:srv|action)/\w+")


@service_group.command("call")
def call_service(
    name: Annotated[
        str, typer.Argument(metavar="SERVICE", help="The service; without a leading / the robot's.")
    ],
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TYPE] [VALUES]",
            help="The type, which may be left out, and the request as YAML: {field: value}.",
        ),
    ] = None,
    timeout: Annotated[
        float, typer.Option(metavar="S", help="Wait S seconds for the response.")
    ] = 30.0,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Call a service and print its response.

    Exit code 0 for any response, 2 for a wrong type or value, 3 if no such service is found within
    5 s or it does not respond.

    \b
    Examples:
      robotctl service call /set_mode "{requested_mode: 1}"
      robotctl service call /estop std_srvs/srv/Trigger
    """
    if not timeout > 0:
        raise UsageError(f"--timeout {timeout:g}", "give seconds above 0")
    type_name, values = parse_words(words or [])
    view = ros_view(robot, domain_id)
    answer = view.call_service(
        view.full_name(name), type_name, values, wait_s=SERVICE_S, answer_s=timeout
    )
    from robotctl.messages.definition import parse_definition
    from robotctl.messages.values import Decoder

    definition = parse_definition(answer["type"], answer["definition"])
    response = Decoder(definition).values(base64.b64decode(answer["data"]))
    told = {"type": answer["type"], "response": plain_json(response)}
    print_answer(told, message_lines(response, None), as_json=as_json)


def parse_words(words: list[str]) -> tuple[str, Any]:
    """Return the type, or "" if none is given, and the values that follow the service's name.

    Raises:
        UsageError: The values are not YAML like {field: value}, or a word follows the values.
    """
    given = list(words)
    type_name = given.pop(0) if given and _TYPE.fullmatch(given[0]) else ""
    text = given.pop(0) if given else "{}"
    if given:
        raise UsageError(
            f"{given[0]!r} is too much", 'put the values into quotes: "{field: value}"'
        )
    from yaml import YAMLError, safe_load

    try:
        values = safe_load(text)
    except YAMLError as error:
        what = getattr(error, "problem", None) or "it cannot be parsed"
        raise UsageError(f"{text!r} is not YAML: {what}", 'write "{field: value}"') from None
    values = {} if values is None else values
    if not isinstance(values, dict):
        raise UsageError(f"{text!r} has no fields", 'write "{field: value}"')
    return type_name, values


@service_group.command("list")
def list_services(
    types: Types = False,
    every: All = False,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """List the services on ROS.

    \b
    Examples:
      robotctl service list -t
    """
    graph = ros_view(robot, domain_id).names()
    print_names(graph, "services", every=every, types=types, as_json=as_json)
