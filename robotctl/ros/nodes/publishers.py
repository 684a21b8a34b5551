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
    """Publishes on `topic` whether commands are locked. Does nothing if `topic` is ""."""

    def __init__(self, node: Node, topic: str) -> None:
        own = OwnTopic(topic, Bool, qos.LATCHED)
        self._publisher = own.create_publisher(node) if topic else None

    def show(self, mode: Mode) -> None:
        """Publish True if `mode` is ERROR or EMERGENCY_STOP, False otherwise."""
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
        """Publish diagnoses, stamped now. Characters that are not printable are escaped."""
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
MARK_TOPIC = OwnTopic("robotctl/marks", String, qos.MARK)

_log = logging.getLogger(__name__)


class TextPublisher:
    """Publishes texts on a topic of type String, from the hidden node `_recorder`."""

    def __init__(self, session: Session, topic: OwnTopic) -> None:
        self._publisher = topic.create_publisher(session.helper())

    def publish(self, text: str) -> bytes:
        """Publish a text, and return the serialized message. A failure is only logged."""
        serialized = bytes(serialize_message(String(data=text)))
        try:
            self._publisher.publish(serialized)
        except _rclpy.RCLError as error:
            _log.warning("nothing can be published on %s: %s", self._publisher.topic_name, error)
        return serialized


JOURNAL_TOPIC = OwnTopic("robotctl/journal", JournalEntry, qos.JOURNAL)


class JournalPublisher:
    """Publishes serialized journal entries on `JOURNAL_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session) -> None:
        # Called when a subscription comes or goes; to ask 150 times a second would cost more.
        events = PublisherEventCallbacks(matched=self._matched, use_default_callbacks=False)
        self._publisher = JOURNAL_TOPIC.create_publisher(session.helper(), events)
        self._subscriptions = 0
        self._failing = False

    def publish(self, serialized: bytes) -> None:
        """Publish an entry if the topic has a subscriber. A failure is only logged."""
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


ROSOUT_TOPIC: Final = OwnTopic("/rosout", Log, qos.ROSOUT)
"""One topic for all nodes of a domain."""

MAX_TEXT: Final = 10_000
"""Limit on the characters of a line. The rest is cut off."""


class RosoutPublisher:
    """Publishes log lines on `ROSOUT_TOPIC`, from the hidden node `_recorder`."""

    def __init__(self, session: Session) -> None:
        self._publisher = ROSOUT_TOPIC.create_publisher(session.helper())

    def publish(self, record: logging.LogRecord, level: int, logger: str, text: str) -> None:
        """Publish a log record as a ROS Log message with this level, logger name and text.

        Raises:
            Exception: A field of `record` has a wrong type or value, or the middleware failed.
        """
        seconds, nanoseconds = divmod(round(record.created * 1e9), NS_PER_S)
        self._publisher.publish(
            Log(
                stamp=Time(sec=seconds, nanosec=nanoseconds),
                level=level,
                name=logger,
                msg=text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]} ...",
                file=record.pathname,
                function=record.funcName or "",
                line=record.lineno,
            )
        )
