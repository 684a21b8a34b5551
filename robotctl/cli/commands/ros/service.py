"""service: list services, and call one."""

from __future__ import annotations

import base64
import re
from typing import Annotated, Any

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import All, DomainId, Json, Robot, Types, new_app
from robotctl.cli.targets.ros_view import ros_view
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.ros_text import left_out_lines, message_lines, name_lines, plain_json, shown

SERVICE_S = 5.0
"""How long to look for the service [s]."""

_TYPE = re.compile(r"\w+/(?:srv|action)/\w+")


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
    """Return the type ("" if it is left out) and the values that follow the service's name.

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


app = new_app()
group = new_app()
app.add_typer(group, name="service")


@group.callback()
def service() -> None:
    """Show the services on ROS, and call them.

    \b
    Examples:
      robotctl service list -t
      robotctl service call /set_mode "{requested_mode: 1}"
    """


group.command("list")(list_services)
group.command("call")(call_service)
