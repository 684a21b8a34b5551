"""Who else is on the graph: whether a robot is there already, and who else commands it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from robotctl.daemon.ending import until
from robotctl.kernel.types import CommandPublishersSeen, Event
from robotctl.ros.odom_subscriber import OdomSubscriber
from robotctl.ros.velocity_publisher import VelocityPublisher

DISCOVERY_S = 4.0
"""How long a start listens for somebody else's odometry before it simulates a robot.

Fast DDS finds a process of the same machine within 0.15 s mostly, and within 2.6 s at worst.
"""

PUBLISHER_POLL_S = 0.2


async def somebody_is_driven(odometry: OdomSubscriber, stop: asyncio.Event) -> bool:
    """Listen for a robot that publishes odometry already; end early when told to stop."""
    await until(lambda: odometry.count_publishers() > 0 or stop.is_set(), DISCOVERY_S)
    return odometry.count_publishers() > 0


async def watch_publishers(velocity: VelocityPublisher, dispatch: Callable[[Event], None]) -> None:
    """Tell the kernel who else publishes the velocity command, until cancelled."""
    seen: tuple[str, ...] = ()
    while True:
        others = velocity.other_publishers() if velocity.count_publishers() > 1 else ()
        if others != seen:
            seen = others
            dispatch(CommandPublishersSeen(time.monotonic_ns(), others))
        await asyncio.sleep(PUBLISHER_POLL_S)
