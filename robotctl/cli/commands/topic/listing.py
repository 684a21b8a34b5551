"""topic list: the names of the topics."""

from __future__ import annotations

from robotctl.cli.commands.topic.options import RecordedFile
from robotctl.cli.options import DomainId, Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.names import All, Types, is_hidden, left_out_lines, name_lines, shown
from robotctl.cli.support.recording_paths import find_recording
from robotctl.cli.support.ros_view import ros_view
from robotctl.paths import DEFAULT_ROBOT


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
    topics = shown(graph["topics"], every)
    lines = [*name_lines(topics, types), *left_out_lines(graph["left_out"])]
    print_answer({"topics": topics}, lines, as_json=as_json)


def _list_recorded(file: str, *, every: bool, as_json: bool) -> None:
    from robotctl.cli.terminal.topic_lines import TopicLines
    from robotctl.recording import read_info

    found = read_info(find_recording(file, None))
    topics = [each for each in found.topics if every or not is_hidden(each.name)]
    table = TopicLines((each.name, each.type_name) for each in topics)
    rows = (
        table.row(each.name, each.type_name, each.message_count, each.rate_hz) for each in topics
    )
    answer = [
        {"name": each.name, "types": [each.type_name], "count": each.message_count}
        for each in topics
    ]
    print_answer({"topics": answer}, [table.header, *rows], as_json=as_json)
