"""Query ROS for a command: the graph through the daemon, all else through a new process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from robotctl.base.domains import requested_domain
from robotctl.base.environment import RANGE
from robotctl.base.errors import NoDaemon, RobotctlError, UsageError, error_for_exit_code
from robotctl.base.paths import namespace_of
from robotctl.base.processes import Child, program, start
from robotctl.base.unknown_name import only_type, unknown_name
from robotctl.ipc.answers import Graph, GraphNode, GraphTopic
from robotctl.ipc.client import call
from robotctl.ipc.method_names import GRAPH, GRAPH_NODE, GRAPH_TOPIC, STATUS
from robotctl.ipc.protocol import MAX_GRAPH_NAME

QUERY: Final = "robotctl.ros.queries"
"""The module of the process that queries ROS."""

END_S: Final = 10.0
"""The timeout for that process to leave its ROS domain and exit [s]."""

ANSWER_S: Final = 30.0
"""The timeout of an answer [s]; discovery takes up to 3.5 s."""


@dataclass(frozen=True, slots=True)
class RosView:
    """Queries one ROS domain; `namespace` begins with a slash, or is ""."""

    robot: str
    namespace: str
    domain_id: int
    through_daemon: bool
    """Whether the robot's daemon answers about the graph, not a new process."""

    def names(self) -> Graph:
        """Return the names of all topics, services and nodes."""
        if self.through_daemon:
            return call(self.robot, GRAPH)
        answer: Graph = self._ask("names")
        return answer

    def topic(self, name: str) -> GraphTopic:
        """Return the endpoints of the topic with the full name `name`.

        Raises:
            UsageError: No node publishes or subscribes to the topic.
        """
        if self.through_daemon:
            found = call(self.robot, GRAPH_TOPIC, {"name": _checked(name)})
        else:
            found = self._ask("topic", name=_checked(name))
        if not found["types"]:
            raise UsageError(*unknown_name("topic", name, _names(self.names()["topics"])))
        return found

    def node(self, name: str) -> GraphNode:
        """Return the topics and services that the node with the full name `name` uses or serves.

        Raises:
            UsageError: There is no such node.
        """
        try:
            if self.through_daemon:
                return call(self.robot, GRAPH_NODE, {"name": _checked(name)})
            answer: GraphNode = self._ask("node", name=_checked(name))
            return answer
        except UsageError:
            known = self.names()["nodes"]
            raise UsageError(*unknown_name("node", name, known)) from None

    def full_name(self, name: str) -> str:
        """Return the full name of a topic, node or service; relative names get the namespace."""
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def listen(self, topic: str, type_name: str, *, data: bool) -> MessageListener:
        """Subscribe to a topic; without `data`, the listener gets only times and sizes.

        Raises:
            UsageError: There is no such topic, or it has several types and `type_name` is "".
        """
        expected = False
        if self.through_daemon and not type_name:  # the daemon knows at once if there is no topic
            found = self.topic(topic)
            expected = bool(found["publishers"])
            type_name = only_type(topic, found["types"])
        request = {"name": _checked(topic), "type": type_name, "data": data, "expected": expected}
        return MessageListener(self._start("listen", **request))

    def call_service(
        self, name: str, type_name: str, values: Any, *, wait_s: float, answer_s: float
    ) -> dict[str, Any]:
        """Call a service and return {"type", "definition", "data"} of its response.

        Raises:
            NoDaemon: No such service appears within `wait_s`, or no answer within `answer_s`.
            UsageError: A value does not fit the service's type.
        """
        expected = self.through_daemon and name in _names(self.names()["services"])
        answer: dict[str, Any] = self._ask(
            "call",
            wait_s + answer_s,
            name=_checked(name),
            expected=expected,
            type=type_name,
            values=values,
            wait_s=wait_s,
            answer_s=answer_s,
        )
        return answer

    def _ask(self, look: str, longer_s: float = 0.0, **request: Any) -> Any:
        child = self._start(look, **request)
        try:
            return _checked_report(child.receive_one(ANSWER_S + longer_s))
        except (EOFError, TimeoutError):
            raise RobotctlError("the process that looks at ROS did not answer") from None
        finally:
            child.close_stdin()
            child.close(END_S)

    def _start(self, look: str, **request: Any) -> Child:
        from json import dumps

        child = start(program(QUERY), with_stdin=True)
        given = {"look": look, "domain_id": self.domain_id, **request}
        line = dumps(given)
        with suppress(BrokenPipeError):  # it has ended; the first receive notices
            child.send(f"{line}\n".encode())
        return child


class MessageListener:
    """Receives the messages of a topic until the end of its `with` block."""

    def __init__(self, child: Child) -> None:
        """Wait until the process `child` reports the topic's type and publishers.

        Raises:
            RobotctlError: The process cannot subscribe to the topic.
        """
        self._child = child
        try:
            first = _checked_report(child.receive_one(ANSWER_S))
        except (EOFError, TimeoutError):
            child.close()
            raise RobotctlError("the process that listens did not answer") from None
        except BaseException:
            child.close(END_S)
            raise
        self.type_name: str = first["type"]
        self.definition: str = first["definition"]
        self.publishers: int = first["publishers"]

    def __enter__(self) -> MessageListener:
        """Return the listener itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._child.close(END_S)

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when a message arrives."""
        return self._child.fileno()

    def receive(self, seconds: float) -> Iterator[dict[str, Any]]:
        """Yield the messages that have arrived; without any, wait for one at most `seconds`.

        Raises:
            RobotctlError: The process that listens has ended, or reported an error.
        """
        try:
            reports = self._child.receive(seconds)
        except TimeoutError:
            return
        except EOFError:
            raise RobotctlError("the process that listens has ended") from None
        yield from map(_checked_report, reports)


def ros_view(robot: str, domain_id: int | None) -> RosView:
    """Return the view of the ROS domain `domain_id`, or of the daemon's if `domain_id` is None.

    Without a daemon, None means the domain of ROS_DOMAIN_ID, or else 0.

    Raises:
        UsageError: The number is not a ROS domain.
    """
    if domain_id is None:
        try:
            status = call(robot, STATUS)
        except NoDaemon:
            pass
        else:
            os.environ.setdefault(RANGE, status["discovery_range"])
            return RosView(robot, status["namespace"], status["domain_id"], through_daemon=True)
    domain = requested_domain(domain_id) or 0
    return RosView(robot, namespace_of(robot), domain, through_daemon=False)


def _names(typed: Any) -> list[str]:
    return [each["name"] for each in typed]


def _checked(name: str) -> str:
    """Return `name` if it can be a name in ROS.

    Raises:
        UsageError: The name is too long or not printable.
    """
    if len(name) > MAX_GRAPH_NAME or not name.isprintable():
        raise UsageError(f"{name[:40]!r} is no name in ROS")
    return name


def _checked_report(report: dict[str, Any]) -> dict[str, Any]:
    """Return the report unless it is an error.

    Raises:
        RobotctlError: The process reported this error.
    """
    if "error" in report:
        raise error_for_exit_code(report["exit_code"], report["error"], report)
    return report
