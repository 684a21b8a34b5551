"""Receives the velocities that another node wants while the robot is guarded."""

from __future__ import annotations

import struct
from collections.abc import Callable
from math import nan

from robotctl.kernel.types import Twist
from robotctl.ros.messages.command_type import CommandType
from robotctl.ros.nodes.numbered_subscriber import NumberedSubscriber
from robotctl.ros.session import Session


class GuardSubscriber(NumberedSubscriber[Twist]):
    """Hands on each wanted velocity, NaN for an unreadable one."""

    def __init__(
        self,
        session: Session,
        topic: str,
        command: CommandType,
        on_command: Callable[[Twist, str, int], None],
    ) -> None:
        """Call `on_command(twist, publisher, sequence)` for each message of this type."""

        def read(data: bytes) -> Twist:
            try:
                return command.decode(data)
            except struct.error:
                return Twist(nan, nan)

        super().__init__(session, command.message_class, topic, read, on_command)
