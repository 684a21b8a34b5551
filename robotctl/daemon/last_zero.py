"""The last command of a daemon reaches the recorder and the robot before its publisher goes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from robotctl.daemon.waiting import until
from robotctl.ros.nodes.mode_service import ModeService
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher

_log = logging.getLogger(__name__)

DRAIN_S = 3.0
"""How long a stop waits until the recorder has received the last command."""

ACKNOWLEDGED_S = 1.0
"""How long a stop waits until the robot has received it. Fast DDS forgets what was not acknowledged
when the publisher goes; later the robot's command timeout has stopped it."""


class LastZero:
    """Waits until the last command and status have arrived.

    `received()` returns how many messages of each topic the recorder has received.
    """

    def __init__(
        self,
        velocity: VelocityPublisher,
        modes: ModeService,
        received: Callable[[], Mapping[str, int]],
    ) -> None:
        self._velocity = velocity
        self._modes = modes
        self._received = received

    async def arrived(self) -> None:
        """Wait, but not longer than a stop may take; warn if the robot has not received it."""
        await until(self._is_recorded, DRAIN_S)
        if not await until(self._velocity.is_acknowledged, ACKNOWLEDGED_S):
            _log.warning(
                "a subscriber of %s has not acknowledged the last zero within %g s",
                self._velocity.topic,
                ACKNOWLEDGED_S,
            )

    def _is_recorded(self) -> bool:
        received = self._received()
        return (
            received.get(self._velocity.topic, 0) >= self._velocity.published
            and received.get(self._modes.status_topic, 0) >= self._modes.published
        )
