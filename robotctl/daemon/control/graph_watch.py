"""The watch on the ROS graph: publishers of odometry, publishers and subscribers of commands."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable

from robotctl.daemon.waiting import until
from robotctl.kernel.types import CommandListenersSeen, CommandPublishersSeen, Event
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher

DISCOVERY_S = 4.0
"""How long a start waits for a publisher of odometry before it simulates a robot.

Fast DDS usually discovers a process on the same machine within 0.15 s, at worst within 2.6 s.
"""

PUBLISHER_POLL_S = 0.2

LOOKS_PER_INSPECTION = 5
"""Subscriptions are inspected at each such look, even if their number is the same."""


async def has_odometry_publisher(odometry: OdomSubscriber, stop: asyncio.Event) -> bool:
    """Wait for a publisher of odometry; return whether there is one. `stop` ends the wait."""
    await until(lambda: odometry.count_publishers() > 0 or stop.is_set(), DISCOVERY_S)
    return odometry.count_publishers() > 0


async def watch_graph(
    velocity: VelocityPublisher, odometry: OdomSubscriber, dispatch: Callable[[Event], None]
) -> None:
    """Dispatch changes of the command's other publishers and of its subscribers, until cancelled.

    Also find the names of the publishers of odometry.
    """
    publishers: tuple[str, ...] = ()
    listeners: tuple[int, tuple[str, ...]] | None = None
    count = -1
    for look in itertools.count():
        others = velocity.other_publishers() if velocity.count_publishers() > 1 else ()
        if others != publishers:
            publishers = others
            dispatch(CommandPublishersSeen(time.monotonic_ns(), others))
        if count != (count := velocity.count_listeners()) or look % LOOKS_PER_INSPECTION == 0:
            seen = velocity.listeners()
            if seen != listeners:
                listeners = seen
                dispatch(CommandListenersSeen(time.monotonic_ns(), *seen))
        odometry.find_names()
        await asyncio.sleep(PUBLISHER_POLL_S)
