"""Runs the simulated robot in a daemon, or in a process of its own that outlives the daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace

from robotctl.base.own_process import end_signals
from robotctl.config import Config
from robotctl.daemon.supervisor import DISCOVERY_S, until
from robotctl.kernel.params import Stamping
from robotctl.kernel.state import full_level
from robotctl.ros.message_types import COMMANDS, PLAIN, CommandType, stamped
from robotctl.ros.nodes.simulated_robot import SimulatedRobot, battery_topic, odometry_topic
from robotctl.ros.session import Session, ros_session
from robotctl.ros.tap.tap import Tap


async def simulate(
    config: Config,
    *,
    domain_id: int,
    namespace: str,
    on_ready: Callable[[], None],
    at_end: ExitStack,
    only_if_missing: bool = False,
) -> None:
    """Run a simulated robot until a signal such as SIGTERM ends it.

    `on_ready()` is called once it runs. With `only_if_missing`, no robot is run if the odometry
    topic has a publisher already. The caller closes `at_end` last, to leave the ROS domain.
    """
    stop = end_signals()
    topics = config.kernel
    is_stamped = topics.command.stamped is Stamping.TRUE
    async with ros_session(domain_id=domain_id, namespace=namespace, at_end=at_end) as session:
        if only_if_missing and await _has_odometry(session, topics.odometry.topic, stop):
            return
        command_type = stamped(topics.command.frame_id) if is_stamped else PLAIN
        offered = replace(command_type, qos=COMMANDS[topics.command.qos])
        running = asyncio.create_task(simulated_robot(session, config, offered).run())
        on_ready()
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({running, stopped}, return_when=asyncio.FIRST_COMPLETED)
        if running.done():
            running.result()
        running.cancel()
        stopped.cancel()


def simulated_robot(session: Session, config: Config, command_type: CommandType) -> SimulatedRobot:
    """Return a simulated robot as configured, which subscribes to commands of `command_type`."""
    topics = config.kernel
    return SimulatedRobot(
        session,
        config.sim,
        command=topics.command.topic,
        command_type=command_type,
        odometry=topics.odometry.topic,
        battery=topics.battery.topic,
        full_level=full_level(topics.battery.scale),
    )


def recorded_robot(
    session: Session, config: Config, command_type: CommandType, tap: Tap
) -> SimulatedRobot:
    """Return the simulated robot, after subscribing the daemon's recorder to its topics."""
    topics = config.kernel
    tap.subscribe_own(odometry_topic(topics.odometry.topic))
    if topics.battery.topic:
        tap.subscribe_own(battery_topic(topics.battery.topic))
    return simulated_robot(session, config, command_type)


async def _has_odometry(session: Session, topic: str, stop: asyncio.Event) -> bool:
    """Return whether `topic` gets a publisher, or `stop` is set, within DISCOVERY_S."""
    node = session.node("simulated_robot_wanted")
    name = session.resolve(topic)
    await until(lambda: node.count_publishers(name) > 0 or stop.is_set(), DISCOVERY_S)
    return node.count_publishers(name) > 0 or stop.is_set()
