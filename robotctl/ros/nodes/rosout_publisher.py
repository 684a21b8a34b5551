"""Publishes log lines on /rosout, where ROS tools look for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import Log

from robotctl.kernel.units import NS_PER_S
from robotctl.ros.messages import qos
from robotctl.ros.messages.own_topic import OwnTopic
from robotctl.ros.session import Session

TOPIC: Final = OwnTopic("/rosout", Log, qos.ROSOUT)
"""One topic for all nodes of a domain."""

MAX_TEXT: Final = 10_000
"""Characters of a line; more are cut off."""


@dataclass(frozen=True, slots=True)
class RosoutLine:
    """A log line; `level` is a number of rcl_interfaces/msg/Log, `logger` the name on ROS."""

    t_ns: int
    """Since the epoch."""

    level: int
    logger: str
    text: str
    file: str
    function: str
    line: int


class RosoutPublisher:
    """Publishes on `TOPIC`, as a part of the hidden node."""

    def __init__(self, session: Session) -> None:
        self._publisher = TOPIC.create_publisher(session.helper())

    def publish(self, line: RosoutLine) -> None:
        """Publish a line.

        Raises:
            Exception: It is no text, or the middleware failed.
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
