"""What all roles promise: their names, their topics, and no QoS events in the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from robotctl.messages.cdr import JOURNAL_ENTRY
from robotctl.recording.format import journal
from robotctl.ros.nodes import publishers
from robotctl.ros.nodes.input_subscribers import BatterySubscriber
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
from robotctl.sim.robot import SimParams

Until = Callable[[Callable[[], object]], Awaitable[None]]


async def test_a_simulated_robot_stops_at_bytes_that_are_no_command(session: Session) -> None:
    robot = SimulatedRobot(
        session,
        SimParams(),
        command="cmd_vel",
        odometry="odom",
        battery="",
        full_level=1.0,
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
    BatterySubscriber(session, "battery_state", lambda *_: None)
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


async def test_the_roles_are_the_nodes_that_are_promised(session: Session, node: Any) -> None:
    VelocityPublisher(session, "cmd_vel")
    OdomSubscriber(session, "odom", print, print)
    service = ModeService(session, "r2", lambda requested, source: asyncio.Future())
    assert service.status_topic == "/r2/robot_status"
    names = {owner.get_fully_qualified_name() for owner in session._nodes}
    assert names == {"/r2/velocity_publisher", "/r2/odom_subscriber", "/r2/mode_service"}


async def test_diagnostics_are_told_whatever_bytes_a_path_has(
    session: Session, executor: Any, node: Any, until: Until
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

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
