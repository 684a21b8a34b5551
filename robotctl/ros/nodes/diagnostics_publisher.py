"""Publishes the state of the daemon's parts as ROS diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from robotctl.printable import printable
from robotctl.ros.messages import qos
from robotctl.ros.messages.own_topic import OwnTopic
from robotctl.ros.session import Session

TOPIC = OwnTopic("/diagnostics", DiagnosticArray, qos.DIAGNOSTICS)
"""One topic for all robots, outside their namespaces, as aggregators expect."""


class DiagnosticLevel(Enum):
    """The severity of a diagnosis."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The state of one part: a sentence, and named values."""

    part: str
    level: DiagnosticLevel
    message: str
    values: Mapping[str, str]


class DiagnosticsPublisher:
    """Publishes on `TOPIC`, as a part of the hidden node."""

    def __init__(self, session: Session, robot: str) -> None:
        self._robot = robot
        self._node = session.helper()
        self._publisher = TOPIC.create_publisher(self._node)

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
