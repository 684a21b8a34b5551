"""Receives the velocities that another node wants while the robot is guarded."""

from __future__ import annotations

import struct
from collections.abc import Callable
from math import nan

from robotctl.kernel.types import Twist
from robotctl.ros.messages import qos
from robotctl.ros.messages.command_type import CommandType
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session


class GuardSubscriber:
    """Receives from publishers of any QoS, as a part of the hidden node."""

    def __init__(
        self,
        session: Session,
        topic: str,
        command: CommandType,
        on_command: Callable[[Twist], None],
    ) -> None:
        """Call `on_command(twist)` for each message of this type; NaN for an unreadable one."""
        self._decode = command.decode
        self._on_command = on_command
        self._subscription = session.helper().create_subscription(
            command.message_class,
            topic,
            self._receive,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(self, data: bytes) -> None:
        try:
            twist = self._decode(data)
        except struct.error:
            twist = Twist(nan, nan)
        self._on_command(twist)
