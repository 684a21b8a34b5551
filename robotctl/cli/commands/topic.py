"""topic: list topics, show their messages, rates and endpoints."""

from __future__ import annotations

import base64
import struct
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from robotctl.base.errors import Refused, UnreadableFile, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import All, DomainId, Json, Robot, Types, new_app, new_group
from robotctl.cli.targets.recordings import find_recording
from robotctl.cli.targets.ros_view import ros_view
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.ros_text import (
    SHOWN_LENGTH,
    is_hidden,
    message_lines,
    plain_json,
    print_names,
)
from robotctl.cli.ui.text import json_text, moment, printable
from robotctl.ipc.answers import GraphEndpoint, GraphTopic
from robotctl.kernel.constants import NS_PER_S

if TYPE_CHECKING:
    from robotctl.messages.definition import Definition
    from robotctl.recording import Message, TopicInfo


app = new_app()
group = new_group(app, "topic")


@group.callback()
def topic() -> None:
    """Show topics and their messages, live or in a recording.

    \b
    Examples:
      robotctl topic list
      robotctl topic echo /odom pose.pose.position.x
      robotctl topic hz --file last /odom
    """


def _recorded(file: str, topic: str, type_name: str) -> tuple[TopicInfo, Iterator[Message]]:
    """Return a topic of a recording, and its messages in the order of their log times.

    Raises:
        UsageError: The recording has no such topic, or it has several types.
        UnreadableFile: The messages are not in CDR. After the last message: a part is unreadable.
    """
    from robotctl.recording import read_info, read_messages
    from robotctl.recording.table import choose_topic

    path = find_recording(file, None)
    listing = f"robotctl topic list --file {file}"
    info = choose_topic(read_info(path), topic, type_name, listing=listing)
    messages = read_messages(path, {info.name})
    return info, (each for each in messages if each.type_name == info.type_name)


class Printer:
    """Prints the messages of one topic."""

    def __init__(
        self,
        topic: str,
        type_name: str,
        definition: Definition,
        field: str,
        *,
        full_length: bool,
        as_json: bool,
    ) -> None:
        """Print whole messages, or the `field` of each, as YAML or JSON.

        Raises:
            UsageError: The type has no such field.
        """
        from robotctl.messages.fields import WrongValue, parse_path
        from robotctl.messages.values import Decoder

        self._as_json = as_json
        self._topic = topic
        self._type_name = type_name
        self._decoder = Decoder(definition)
        self._limit = None if full_length else SHOWN_LENGTH
        try:
            self._steps = parse_path(definition, field).steps if field else ()
        except WrongValue as error:
            raise UsageError(str(error)) from None

    def print(self, data: bytes, time_ns: int, publish_ns: int, *, with_time: bool) -> None:
        """Print a serialized message, or the chosen field of it, as one line of JSON or as YAML.

        JSON always has both times. YAML has `time_ns`, in seconds, only if `with_time`.
        """
        value = self._value(data)
        if self._as_json:
            about = {"topic": self._topic, "type": self._type_name}
            times = {"time_ns": time_ns, "publish_ns": publish_ns}
            told = {"value" if self._steps else "message": plain_json(value)}
            print(json_text(about | times | told), flush=True)
            return
        lines = list(message_lines(value, self._limit))
        time = [f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}"] if with_time else []
        if isinstance(value, dict | list | bytes):
            print(*(f"# {each}" for each in time), *lines, "---", sep="\n", flush=True)
        else:
            print(*time, *lines, flush=True)

    def _value(self, data: bytes) -> Any:
        from robotctl.messages.fields import WrongValue, value_at

        try:
            return value_at(self._decoder.values(data), self._steps)
        except struct.error as error:
            raise UnreadableFile(f"a message of {self._topic} cannot be read: {error}") from None
        except WrongValue as error:
            raise UsageError(str(error)) from None


RecordedFile = Annotated[
    str,
    typer.Option(
        "--file", metavar="FILE", help="A recording instead of ROS: its path, its name, or `last`."
    ),
]

TopicName = Annotated[
    str, typer.Argument(metavar="TOPIC", help="The topic; without a leading / it is the robot's.")
]

TypeName = Annotated[
    str,
    typer.Option(
        "--type", metavar="TYPE", help="Its type, where it has several or no publisher yet."
    ),
]


NOTE_S = 2.0
"""The time without a message before a note on stderr [s]."""


@group.command()
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

    A message is YAML, and `---` ends it. With --file, its time is shown as well.

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
    from robotctl.messages.definition import parse_definition

    view = ros_view(robot, domain_id)
    name = view.full_name(topic)
    with view.listen(name, type_name, data=True) as listener:
        definition = parse_definition(listener.type_name, listener.definition)
        printer = Printer(
            name,
            listener.type_name,
            definition,
            field,
            full_length=full_length,
            as_json=as_json,
        )
        heard_s, noted = time.monotonic(), False
        while True:
            for message in listener.receive(NOTE_S if timeout is None else min(timeout, NOTE_S)):
                data, received_ns = base64.b64decode(message["data"]), message["received_ns"]
                printer.print(data, received_ns, message["source_ns"], with_time=False)
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
    from robotctl.recording.table import recorded_definition

    info, messages = _recorded(file, topic, type_name)
    definition = recorded_definition(info)
    printer = Printer(
        info.name, info.type_name, definition, field, full_length=full_length, as_json=as_json
    )
    for message in messages:
        printer.print(message.data, message.log_ns, message.publish_ns, with_time=True)
        if once:
            return


@group.command()
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


@group.command("list")
def list_topics(
    file: RecordedFile = "",
    types: Types = False,
    every: All = False,
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """List the topics on ROS, or those in a recording with the number of their messages.

    \b
    Examples:
      robotctl topic list -t
      robotctl topic list --file last
    """
    if file:
        _list_recorded(file, every=every, as_json=as_json)
        return
    graph = ros_view(robot, domain_id).names()
    print_names(graph, "topics", every=every, types=types, as_json=as_json)


def _list_recorded(file: str, *, every: bool, as_json: bool) -> None:
    from robotctl.cli.ui.status import topic_table
    from robotctl.recording import read_info

    found = read_info(find_recording(file, None))
    topics = [each for each in found.topics if every or not is_hidden(each.name)]
    lines = topic_table(
        (each.name, each.type_name, each.message_count, each.rate_hz) for each in topics
    )
    answer = [
        {"name": each.name, "types": [each.type_name], "count": each.message_count}
        for each in topics
    ]
    print_answer({"topics": answer}, lines, as_json=as_json)


PERIOD_S: Final = 1.0
"""The period in which the rate is printed [s]."""


@group.command()
def hz(
    topic: TopicName,
    file: RecordedFile = "",
    once: Annotated[bool, typer.Option("--once", help="End after the first result.")] = False,
    window: Annotated[
        int, typer.Option("-w", "--window", min=2, help="Average over the last N messages.")
    ] = 10_000,
    type_name: TypeName = "",
    robot: Robot = DEFAULT_ROBOT,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Show the rate of a topic each second until Ctrl-C, or over a whole recording.

    \b
    Examples:
      robotctl topic hz /odom
      robotctl topic hz --file last /odom --json
    """
    if file:
        _print_recorded(file, topic, type_name, as_json=as_json)
        return
    view = ros_view(robot, domain_id)
    name = view.full_name(topic)
    times_ns: deque[int] = deque(maxlen=window)
    with view.listen(name, type_name, data=False) as listener:
        print_s, before = time.monotonic() + PERIOD_S, 0
        heard = 0
        while True:
            for message in listener.receive(max(print_s - time.monotonic(), 0.0)):
                times_ns.append(message["received_ns"])
                heard += 1
            if time.monotonic() < print_s:
                continue
            print_s += PERIOD_S
            found = statistics(times_ns) if heard > before else None
            before = heard
            if found is not None:
                _print(found, as_json=as_json)
                if once:
                    return
            elif not as_json:
                print("no new messages", flush=True)


def statistics(times_ns: Sequence[int]) -> dict[str, Any] | None:
    """Return statistics of messages received at `times_ns`, None if the times span no time."""
    times = list(times_ns)
    periods_s = [(after - before) / NS_PER_S for before, after in pairwise(times)]
    total_s = sum(periods_s)
    if not periods_s or total_s <= 0:
        return None
    mean_s = total_s / len(periods_s)
    variance = sum((each - mean_s) ** 2 for each in periods_s) / len(periods_s)
    return {
        "rate_hz": 1.0 / mean_s,
        "min_s": min(periods_s),
        "max_s": max(periods_s),
        "std_dev_s": variance**0.5,
        "window": len(times),
    }


def _print(found: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json_text(found), flush=True)
        return
    print(
        f"average rate: {found['rate_hz']:.3f}\n"
        f"\tmin: {found['min_s']:.3f}s max: {found['max_s']:.3f}s "
        f"std dev: {found['std_dev_s']:.5f}s window: {found['window']}",
        flush=True,
    )


def _print_recorded(file: str, topic: str, type_name: str, *, as_json: bool) -> None:
    info, messages = _recorded(file, topic, type_name)
    times_ns = [message.log_ns for message in messages]
    found = statistics(times_ns)
    if found is None:
        raise Refused(f"{info.name} has {len(times_ns)} messages there: no rate")
    span = {"start_ns": times_ns[0], "end_ns": times_ns[-1]}
    if not as_json:
        print(f"from {moment(times_ns[0])} to {moment(times_ns[-1])}")
    _print(found | span, as_json=as_json)
