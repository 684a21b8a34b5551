"""node: list nodes, and show what one does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer

from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import All, DomainId, Json, Robot, new_app
from robotctl.cli.targets.ros_view import ros_view
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.ros_text import is_hidden, left_out_lines
from robotctl.cli.ui.text import printable
from robotctl.ipc.answers import GraphNode

app = new_app()
group = new_app()
app.add_typer(group, name="node")

_SECTIONS = {
    "subscriptions": "Subscribers",
    "publishers": "Publishers",
    "servers": "Service Servers",
    "clients": "Service Clients",
}
_ACTION = "/_action/"


@group.callback()
def node() -> None:
    """Show the nodes on ROS, and what each one does there.

    \b
    Examples:
      robotctl node list
      robotctl node info /mode_service
    """


@group.command("list")
def list_nodes(
    every: All = False,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """List the nodes on ROS; one name stands there twice if two nodes have it.

    \b
    Examples:
      robotctl node list
    """
    graph = ros_view(robot, domain_id).names()
    nodes = [name for name in graph["nodes"] if every or not is_hidden(name)]
    lines = [*map(printable, nodes), *left_out_lines(graph["left_out"])]
    print_answer({"nodes": nodes}, lines, as_json=as_json)


@group.command()
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
            action, _, service = each["name"].partition(_ACTION)
            if service == "send_goal":
                types = ", ".join(each["types"]).replace("_SendGoal", "")
                yield f"    {printable(action)}: {printable(types)}"
