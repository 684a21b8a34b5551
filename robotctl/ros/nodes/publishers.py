"""Publishers of the command lock, diagnostics, the seal's heads, the journal, marks and logs."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Log
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message
from robot_controller.msg import JournalEntry
from std_msgs.msg import Bool, String

from robotctl.base.text import printable
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.ros import qos
from robotctl.ros.message_types import OwnTopic
from robotctl.ros.session import Session

LOCKING = frozenset({Mode.ERROR, Mode.EMERGENCY_STOP})
"""The modes in which no node may command the robot."""


class CommandLock:
    """Publishes from `node` whether commands are locked; if `topic` is "", does nothing."""

    def __init__(self, node: Node, topic: str) -> None:
        own = OwnTopic(topic, Bool, qos.LATCHED)
        self._publisher = own.create_publisher(node) if topic else None

    def show(self, mode: Mode) -> None:
        """Publish True if `mode` is one of LOCKING, False otherwise."""
        if self._publisher is not None:
            self._publisher.publish(Bool(data=mode in LOCKING))


DIAGNOSTICS_TOPIC = OwnTopic("/diagnostics", DiagnosticArray, qos.DIAGNOSTICS)
"""One topic for all robots, outside their namespaces, as aggregators expect."""


class DiagnosticLevel(Enum):
    """The severity of a diagnosis."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The state of one part of the daemon: a level, a sentence and named values."""

    part: str
    level: DiagnosticLevel
    message: str
    values: Mapping[str, str]


class DiagnosticsPublisher:
    """Publishes diagnoses on `DIAGNOSTICS_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session, robot: str) -> None:
        self._robot = robot
        self._node = session.helper()
        self._publisher = DIAGNOSTICS_TOPIC.create_publisher(self._node)

    def publish(self, *diagnoses: Diagnosis) -> None:
        """Publish diagnoses, stamped now; characters that are not printable are escaped."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=each.level.value,
                name=f"{self._robot}: {each.part}",
                message=printable(each.message),
                hardware_id=self._robot,
                values=[
                    KeyValue(key=key, value=printable(text)) for key, text in each.values.items()
                ],
            )
            for each in diagnoses
        ]
        self._publisher.publish(message)


HEAD_TOPIC = OwnTopic("robotctl/head", String, qos.LATCHED)

_log = logging.getLogger(__name__)


class HeadPublisher:
    """Publishes heads of the seal on `HEAD_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session) -> None:
        node = session.helper()
        self._publisher = HEAD_TOPIC.create_publisher(node)

    def publish(self, digest: str) -> None:
        """Publish `digest`, the head of the seal in hex; a failure is only logged."""
        try:
            self._publisher.publish(bytes(serialize_message(String(data=digest))))
        except _rclpy.RCLError as error:
            _log.warning("the head of the seal cannot be published: %s", error)


JOURNAL_TOPIC = OwnTopic("robotctl/journal", JournalEntry, qos.JOURNAL)


class JournalPublisher:
    """Publishes serialized journal entries on `JOURNAL_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session) -> None:
        node = session.helper()
        # Called when a subscription comes or goes; to ask 150 times a second would cost more.
        events = PublisherEventCallbacks(matched=self._matched, use_default_callbacks=False)
        self._publisher = JOURNAL_TOPIC.create_publisher(node, events)
        self._subscriptions = 0
        self._failing = False

    def publish(self, serialized: bytes) -> None:
        """Publish an entry if the topic has a subscriber; a failure is only logged."""
        if not self._subscriptions:
            return  # the topic is volatile: no later subscriber gets it
        try:
            self._publisher.publish(serialized)
            self._failing = False
        except _rclpy.RCLError as error:
            if not self._failing:
                _log.warning("the journal cannot be published: %s", error)
            self._failing = True

    def _matched(self, status: Any) -> None:
        self._subscriptions = status.current_count


MARK_TOPIC = OwnTopic("robotctl/marks", String, qos.MARK)


class MarkPublisher:
    """Publishes marks on `MARK_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session) -> None:
        node = session.helper()
        self._publisher = MARK_TOPIC.create_publisher(node)

    def publish(self, text: str) -> bytes:
        """Publish a mark, and return the serialized message; a failure is only logged."""
        serialized = bytes(serialize_message(String(data=text)))
        try:
            self._publisher.publish(serialized)
        except _rclpy.RCLError as error:
            _log.warning("the mark cannot be published: %s", error)
        return serialized


ROSOUT_TOPIC: Final = OwnTopic("/rosout", Log, qos.ROSOUT)
"""One topic for all nodes of a domain."""

MAX_TEXT: Final = 10_000
"""Limit on the characters of a line; the rest is cut off."""


@dataclass(frozen=True, slots=True)
class RosoutLine:
    """A log line; `level` is as in rcl_interfaces/msg/Log, `logger` the logger's name on ROS."""

    t_ns: int
    """Wall-clock time since the epoch [ns]."""

    level: int
    logger: str
    text: str
    file: str
    function: str
    line: int


class RosoutPublisher:
    """Publishes log lines on `ROSOUT_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session) -> None:
        self._publisher = ROSOUT_TOPIC.create_publisher(session.helper())

    def publish(self, line: RosoutLine) -> None:
        """Publish a log line.

        Raises:
            Exception: A field of `line` has a wrong type or value, or the middleware failed.
        """
        seconds, nanoseconds = divmod(line.t_ns, NS_PER_S)
        self._publisher.publish(
            Log(
                stamp=Time(sec=seconds, nanosec=nanoseconds),
                level=line.level,
                name=line.logger,
                msg=line.text if len(line.text) <= MAX_TEXT else f"{line.text[:MAX_TEXT]} ...",
                file=line.file,
                function=line.function,
                line=line.line,
            )
        )
