"""The end of a daemon: stop the robot, and wait until the last command is recorded."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress

from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.supervisor import until
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ZERO, Cause, FaultReported, ModeRequested, Tick
from robotctl.ros.nodes.mode_service import ModeService
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher

_log = logging.getLogger(__name__)

RAMP_DOWN_S = 3.0
"""How long the ramp may take before zero is commanded at once."""

LAST_ZERO_S = 1.0
"""How long the last zero is retried."""


_ENDING = "the daemon is stopping"


async def stand_still(
    control: Control,
    published: Callable[[], int],
    *,
    ramp_down_s: float = RAMP_DOWN_S,
    now_ns: Callable[[], int] = time.monotonic_ns,
) -> None:
    """Stop the robot at the daemon's end: ramp down, then send a last zero velocity.

    After `ramp_down_s` without standstill, zero is commanded at once. No motion starts afterwards.
    `published()` returns the number of commands sent so far.
    """
    control.dispatch(FaultReported(now_ns(), Cause.DAEMON_ENDS, _ENDING))
    for mode in (Mode.IDLE, Mode.ERROR):
        if control.state.mode is Mode.MOVING:
            request = ModeRequested(now_ns(), control.stamp()[1], mode, "the daemon's end")
            try:
                await asyncio.wait_for(control.request(request), ramp_down_s)
            except TimeoutError:
                _log.error("the robot has not stopped after %g s", ramp_down_s)
    sent = published()

    def sends_zero() -> bool:
        control.dispatch(Tick(now_ns()))
        return published() > sent

    if not await until(sends_zero, LAST_ZERO_S):
        _log.error("the last zero could not be sent within %g s", LAST_ZERO_S)


def send_zero(control: Control, velocity: VelocityPublisher) -> None:
    """Journal the daemon's end as a fault, and command zero velocity."""
    sent = velocity.published
    with suppress(Exception):  # the kernel may be what has failed
        control.dispatch(FaultReported(time.monotonic_ns(), Cause.DAEMON_ENDS, _ENDING))
        if control.state.mode is not Mode.MOVING:
            control.dispatch(Tick(time.monotonic_ns()))
    if velocity.published == sent:
        velocity.publish(ZERO)


DRAIN_S = 3.0
"""How long a stop waits until the recorder has received the last command."""

ACKNOWLEDGED_S = 1.0
"""How long a stop waits until the robot has acknowledged the last zero."""


async def last_zero_arrived(
    velocity: VelocityPublisher, modes: ModeService, received: Callable[[], Mapping[str, int]]
) -> None:
    """Wait until the last command has reached the robot, and the recording has it and the status.

    `received()` returns the recorder's number of messages by topic. Each wait has a limit.
    """

    def is_recorded() -> bool:
        counts = received()
        return (
            counts.get(velocity.topic, 0) >= velocity.published
            and counts.get(modes.status_topic, 0) >= modes.published
        )

    await until(is_recorded, DRAIN_S)
    # Fast DDS discards the zero if the publisher is destroyed before.
    if not await until(velocity.is_acknowledged, ACKNOWLEDGED_S):
        _log.warning(
            "a subscriber of %s has not acknowledged the last zero within %g s",
            velocity.topic,
            ACKNOWLEDGED_S,
        )
