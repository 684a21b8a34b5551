"""The velocity publisher sends commands, holds them at its gate, and names other publishers.

What all roles promise: their names, their topics, and no QoS events in the loop.
"""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node

from robotctl.kernel.constants import TWIST, TWIST_STAMPED
from robotctl.kernel.types import Twist
from robotctl.messages.cdr import JOURNAL_ENTRY
from robotctl.recording.format import journal
from robotctl.ros import qos
from robotctl.ros.graph import endpoints
from robotctl.ros.nodes import publishers
from robotctl.ros.nodes.input_subscribers import report_battery
from robotctl.ros.nodes.mode_service import ModeService
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.publishers import (
    DIAGNOSTICS_TOPIC,
    Diagnosis,
    DiagnosticLevel,
    DiagnosticsPublisher,
)
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.ros.session import Session
from robotctl.sim import SimParams
from tests.support.waiting import loop_until as until


@pytest.fixture
async def heard_velocities(executor: Any, node: Any) -> list[tuple[float, float]]:
    """The commands that another node receives."""
    commands: list[tuple[float, float]] = []
    node.create_subscription(
        TwistMessage,
        "/r2/cmd_vel",
        lambda message: commands.append((message.linear.x, message.angular.z)),
        100,
    )
    return commands


async def test_a_command_is_sent_as_it_is(
    session: Session, heard_velocities: list[tuple[float, float]]
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    await until(velocity._publisher.get_subscription_count)
    velocity.publish(Twist(0.25, -1.5))
    await until(lambda: heard_velocities)
    assert (heard_velocities, velocity.published, velocity.topic) == (
        [(0.25, -1.5)],
        1,
        "/r2/cmd_vel",
    )


async def test_a_command_is_acknowledged_once_each_reliable_subscriber_has_it(
    session: Session, peer: Callable[..., Awaitable[Any]]
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel_of_the_peer")
    assert velocity.is_acknowledged()
    pid = await peer("take_commands", topic="/r2/cmd_vel_of_the_peer")
    await until(velocity._publisher.get_subscription_count)
    await until(velocity.is_acknowledged)
    os.kill(pid, signal.SIGSTOP)
    os.waitid(os.P_PID, pid, os.WSTOPPED)  # noqa: ASYNC222 - for a moment
    try:
        velocity.publish(Twist(0.0, 0.0))
        assert not velocity.is_acknowledged()
    finally:
        os.kill(pid, signal.SIGCONT)
    await until(velocity.is_acknowledged)


async def test_a_closed_gate_lets_zeros_through_only(
    session: Session, heard_velocities: list[tuple[float, float]]
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    await until(velocity._publisher.get_subscription_count)
    velocity.close_gate()
    velocity.publish(Twist(0.25, -1.5))
    thread = threading.Thread(target=velocity.publish_zero)
    thread.start()
    await asyncio.to_thread(thread.join)
    velocity.open_gate()
    velocity.publish(Twist(0.5, 0.0))
    await until(lambda: len(heard_velocities) == 3)
    assert heard_velocities == [(0.0, 0.0), (0.0, 0.0), (0.5, 0.0)]
    assert velocity.published == 3


async def test_a_zero_does_not_wait_for_a_publication_that_hangs(session: Session) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    with velocity._lock, pytest.raises(TimeoutError, match="hangs"):
        velocity.publish_zero()


async def test_only_others_count_as_foreign_publishers(session: Session, node: Any) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    await until(lambda: velocity.count_publishers() == 1)
    assert velocity.other_publishers() == ()
    node.create_publisher(TwistMessage, "/r2/cmd_vel", 10)
    await until(lambda: velocity.other_publishers() == ("/tested",))


async def test_a_second_node_of_our_name_is_foreign(
    session: Session, new_context: Callable[[], Any]
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    impostor = Node("velocity_publisher", namespace="/r2", context=new_context())
    impostor.create_publisher(TwistMessage, "cmd_vel", 10)
    await until(lambda: velocity.other_publishers() == ("/r2/velocity_publisher",))
    impostor.destroy_node()


async def test_of_many_other_publishers_some_are_named_and_the_rest_counted(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    others = [
        endpoints.Endpoint(f"{number:03}{'x' * 400}", "/", "t", b"%d" % number, qos.COMMAND)
        for number in range(600)
    ]
    monkeypatch.setattr(endpoints, "publishers", lambda node, topic: others)
    monkeypatch.setattr(velocity, "count_publishers", lambda: len(others))
    names = velocity.other_publishers()
    assert names[-1] == "592 more"
    assert len("".join(names)) < 2_000


async def test_who_takes_the_command_is_counted_by_type_and_without_recorders(
    session: Session, node: Any, new_context: Callable[[], Any]
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    recorder = session.helper()
    recorder.create_subscription(TwistMessage, "cmd_vel", print, 10)
    another = Node("_recorder", namespace="/r3", context=session._context)
    another.create_subscription(TwistMessage, "/r2/cmd_vel", print, 10)
    velocity.monitor(lambda gid: None, 0.0)
    await until(lambda: velocity.count_listeners() == 3)
    assert velocity.listeners() == (0, (), TWIST)
    stamped = Node("stamped", context=new_context())  # Fast DDS: one type a topic and context
    stamped.create_subscription(TwistStamped, "/r2/cmd_vel", print, 10)
    await until(lambda: velocity.listeners() == (0, (TWIST_STAMPED,), TWIST))
    node.create_subscription(TwistMessage, "/r2/cmd_vel", print, 10)
    await until(lambda: velocity.listeners() == (1, (TWIST_STAMPED,), TWIST))
    stamped.destroy_node()
    await until(lambda: velocity.listeners() == (1, (), TWIST))
    another.destroy_node()


async def test_a_simulated_robot_stops_at_bytes_that_are_no_command(session: Session) -> None:
    robot = SimulatedRobot(
        session, SimParams(), command="cmd_vel", odometry="odom", battery="", full_level=1.0
    )
    for data in (b"", b"\0\1\0\0", b"\0\0\0\0", b"\xff" * 60):
        robot._command(data, 0, 0, 1, b"")


async def test_no_role_has_rclpy_report_qos_events_from_the_loop(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes: list[Any] = []
    make = session.node

    def kept(name: str) -> Any:
        nodes.append(make(name))
        return nodes[-1]

    monkeypatch.setattr(session, "node", kept)
    VelocityPublisher(session, "cmd_vel").monitor(lambda gid: None, 0.01)
    OdomSubscriber(session, "odom", lambda *_: None, lambda *_: None)
    report_battery(session, "battery_state", lambda *_: None)
    ModeService(session, "r2", lambda requested, source: asyncio.Future())
    SimulatedRobot(
        session,
        SimParams(),
        command="cmd_vel",
        odometry="odom",
        battery="battery_state",
        full_level=1.0,
    )
    for entity in (each for node in nodes for each in (*node.publishers, *node.subscriptions)):
        if entity.topic_name != "/parameter_events":  # rclpy's own
            assert entity.event_handlers == [], entity.topic_name


async def test_diagnostics_are_told_whatever_bytes_a_path_has(
    session: Session, executor: Any, node: Any
) -> None:
    heard: list[Any] = []
    diagnostics = DiagnosticsPublisher(session, "r2")
    subscription = node.create_subscription(
        DiagnosticArray, DIAGNOSTICS_TOPIC.name, heard.append, 10
    )
    await until(subscription.get_publisher_count)
    await until(diagnostics._publisher.get_subscription_count)
    diagnostics.publish(
        Diagnosis("recorder", DiagnosticLevel.WARN, "no \x1b[31m", {"file": "/data/\udcff.mcap"})
    )
    await until(lambda: heard)
    (status,) = heard[0].status
    assert (status.message, status.values[0].value) == ("no \\x1b[31m", "/data/\\udcff.mcap")


def test_the_journal_is_declared_as_readers_and_replays_look_for_it() -> None:
    declared = publishers.JOURNAL_TOPIC
    assert (declared.name, declared.type_name) == (journal.TOPIC, JOURNAL_ENTRY)
