"""topic echo: the messages of a topic."""

from __future__ import annotations

import base64
import sys
import time
from typing import Annotated

import typer

from robotctl.cli.commands.topic.options import RecordedFile, TopicName, TypeName
from robotctl.cli.options import DomainId, Json, Robot
from robotctl.cli.support.ros_view import ros_view
from robotctl.cli.terminal.text import printable
from robotctl.errors import Refused, UsageError
from robotctl.paths import DEFAULT_ROBOT

NOTE_S = 2.0
"""Without a message for this time, a line on stderr says that the command still waits."""


def echo(
    topic: TopicName,
    field: Annotated[
        str, typer.Argument(metavar="[FIELD]", help="Only this field: a path like pose.pose.x.")
    ] = "",
    file: RecordedFile = "",
    once: Annotated[bool, typer.Option("--once", help="End after the first message.")] = False,
    timeout: Annotated[
        float | None,
        typer.Option(metavar="S", help="End with code 4 if no message comes for S seconds."),
    ] = None,
    full_length: Annotated[
        bool,
        typer.Option("-f", "--full-length", help="Do not shorten lists and texts to 128."),
    ] = False,
    type_name: TypeName = "",
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Show the messages of a topic, live until Ctrl-C, or all that a recording holds.

    A message is YAML, and `---` ends it. From a recording the time comes with it.

    \b
    Examples:
      robotctl topic echo /robot_status --once
      robotctl topic echo /odom pose.pose.position.x
      robotctl topic echo --file last /odom twist.twist.linear.x
      robotctl topic echo --file run.mcap /odom --json
    """
    if timeout is not None and not timeout > 0:
        raise UsageError(f"--timeout {timeout:g}", "give seconds above 0")
    if file:
        _echo_recorded(
            file, topic, field, type_name, once=once, full_length=full_length, as_json=as_json
        )
        return
    from robotctl.cli.commands.topic.printer import Printer

    view = ros_view(robot, domain_id)
    name = view.full_name(topic)
    with view.listen(name, type_name, data=True) as listener:
        printer = Printer(
            name, listener.type_name, listener.definition, field, full_length=full_length
        )
        heard_s, noted = time.monotonic(), False
        while True:
            for message in listener.receive(NOTE_S if timeout is None else min(timeout, NOTE_S)):
                data = base64.b64decode(message["data"])
                if as_json:
                    printer.print_json(data, message["received_ns"], message["source_ns"])
                else:
                    printer.print_lines(data, None)
                if once:
                    return
                heard_s, noted = time.monotonic(), True
            waited_s = time.monotonic() - heard_s
            if timeout is not None and waited_s >= timeout:
                raise Refused(f"no message on {name} for {timeout:g} s")
            if waited_s >= NOTE_S and not noted:
                noted = True
                count = listener.publishers
                text = f"no message on {name} yet; publishers: {count}. Ctrl-C ends"
                print(f"robotctl: {printable(text)}", file=sys.stderr)


def _echo_recorded(
    file: str,
    topic: str,
    field: str,
    type_name: str,
    *,
    once: bool,
    full_length: bool,
    as_json: bool,
) -> None:
    from robotctl.cli.commands.topic.printer import Printer
    from robotctl.cli.commands.topic.recorded import RecordedTopic

    recorded = RecordedTopic(file, topic, type_name)
    info = recorded.info
    printer = Printer(
        recorded.name, info.type_name, info.definition, field, full_length=full_length
    )
    for message in recorded.messages():
        if as_json:
            printer.print_json(message.data, message.log_ns, message.publish_ns)
        else:
            printer.print_lines(message.data, message.log_ns)
        if once:
            return
