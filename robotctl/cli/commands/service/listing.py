"""service list: the names of the services."""

from __future__ import annotations

from robotctl.cli.options import DomainId, Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.names import All, Types, left_out_lines, name_lines, shown
from robotctl.cli.support.ros_view import ros_view
from robotctl.paths import DEFAULT_ROBOT


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
    services = shown(graph["services"], every)
    lines = [*name_lines(services, types), *left_out_lines(graph["left_out"])]
    print_answer({"services": services}, lines, as_json=as_json)
