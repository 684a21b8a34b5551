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

PUBLISHER_POLL_S = 0.2

LOOKS_PER_INSPECTION = 5
"""Subscriptions are inspected at each such look, even if their number is the same."""


async def has_odometry_publisher(
    odometry: OdomSubscriber, stop: asyncio.Event, until_s: float
) -> bool:
    """Wait for a publisher of odometry until the steady time `until_s` [s] or until `stop`.

    Return whether there is one.
    """
    remaining_s = until_s - time.monotonic()
    await until(lambda: odometry.count_publishers() > 0 or stop.is_set(), remaining_s)
    return odometry.count_publishers() > 0


async def watch_graph(
    velocity: VelocityPublisher,
    odometry: OdomSubscriber,
    dispatch: Callable[[Event], None],
    looked: Callable[[], None] = lambda: None,
) -> None:
    """Dispatch changes of the command's other publishers and of its subscribers, until cancelled.

    Also find the names of the publishers of odometry. `looked()` is called after each look.
    """
    publishers: tuple[str, ...] = ()
    listeners: tuple[int, tuple[str, ...], str] | None = None
    count = -1
    for look in itertools.count():
        others = velocity.other_publishers()
        if others != publishers:
            publishers = others
            dispatch(CommandPublishersSeen(time.monotonic_ns(), others))
        if count != (count := velocity.count_listeners()) or look % LOOKS_PER_INSPECTION == 0:
            seen = velocity.listeners()
            if seen != listeners:
                listeners = seen
                dispatch(CommandListenersSeen(time.monotonic_ns(), *seen))
        odometry.find_names()
        looked()
        await asyncio.sleep(PUBLISHER_POLL_S)
