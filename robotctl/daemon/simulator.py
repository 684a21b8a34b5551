"""The simulated robot as its own process, which outlives a daemon that dies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack

from robotctl.config import Config
from robotctl.end_signals import end_signals
from robotctl.kernel.battery import full_level
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.session import ros_session


async def simulate(
    config: Config,
    *,
    domain_id: int,
    namespace: str,
    on_ready: Callable[[], None],
    at_end: ExitStack,
) -> None:
    """Run the robot until a signal ends it; the exit of `at_end` leaves the ROS domain."""
    stop = end_signals()
    topics = config.kernel
    async with ros_session(domain_id=domain_id, namespace=namespace, at_end=at_end) as session:
        robot = SimulatedRobot(
            session,
            config.sim,
            command=topics.command.topic,
            odometry=topics.odometry.topic,
            battery=topics.battery.topic,
            full_level=full_level(topics.battery.scale),
        )
        running = asyncio.create_task(robot.run())
        on_ready()
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({running, stopped}, return_when=asyncio.FIRST_COMPLETED)
        if running.done():
            running.result()
        running.cancel()
        stopped.cancel()
