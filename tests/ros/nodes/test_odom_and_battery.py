"""Odometry and battery levels are received from publishers of any QoS, and passed on unchanged."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.params import CommandQos, OdometryQos
from robotctl.kernel.types import ZERO, Odometry
from robotctl.messages.motion import OdometryEncoder
from robotctl.printable import MAX_NAME
from robotctl.ros.messages import qos
from robotctl.ros.messages.command_type import PLAIN
from robotctl.ros.nodes import odom_subscriber
from robotctl.ros.nodes.input_subscribers import BatterySubscriber
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.ros.session import Session

Until = Callable[[Callable[[], object]], Awaitable[None]]


@pytest.mark.parametrize("offered", [qos.SENSOR, qos.COMMAND, qos.LATCHED])
async def test_odometry_of_any_quality_of_service_is_taken(
    session: Session, node: Any, until: Until, offered: Any
) -> None:
    from nav_msgs.msg import Odometry as OdometryMessage

    measured: list[tuple[Odometry, int, int]] = []
    sources: list[tuple[int, str, str, str]] = []
    subscriber = OdomSubscriber(
        session,
        "odom",
        lambda odometry, source, sequence: measured.append((odometry, source, sequence)),
        lambda *source: sources.append(source),
    )
    publisher = node.create_publisher(OdometryMessage, "/r2/odom", offered)
    await until(lambda: publisher.get_subscription_count() and subscriber.count_publishers())
    message = OdometryMessage()
    message.pose.pose.position.x = 1.5
    message.pose.pose.orientation.z = math.sin(0.25)
    message.pose.pose.orientation.w = math.cos(0.25)
    message.twist.twist.linear.x = 0.3
    message.header.frame_id = "odom"
    message.header.stamp.sec, message.header.stamp.nanosec = 2, 3
    publisher.publish(message)
    await until(lambda: measured)
    ((odometry, source, sequence),) = measured
    assert (source, sequence) == (1, 1)

    def is_named() -> bool:
        subscriber.find_names()
        return sources[-1][2] != ""

    await until(is_named)
    assert [(number, len(gid)) for number, gid, *_ in sources] == len(sources) * [(1, 32)]
    assert sources[-1][2:] == ("/tested", "odom")
    assert odometry.pose.theta == pytest.approx(0.5)
    assert (odometry.pose.x, odometry.velocity.linear) == (1.5, 0.3)
    assert odometry.stamp_ns == 2_000_000_003


async def test_publishers_of_odometry_are_told_apart_and_numbered(
    session: Session, node: Any, until: Until
) -> None:
    from nav_msgs.msg import Odometry as OdometryMessage

    heard: list[int] = []
    sources: list[int] = []
    OdomSubscriber(
        session,
        "odom",
        lambda odometry, source, sequence: heard.append(source),
        lambda source, *_: sources.append(source),
    )
    publishers = [node.create_publisher(OdometryMessage, "/r2/odom", 10) for _ in range(2)]
    turns = []
    for publisher in (publishers[0], publishers[1], publishers[0]):
        heard.clear()

        # Repeated: messages before the match are lost to a best-effort subscription.
        def is_heard(publisher: Any = publisher) -> bool:
            publisher.publish(OdometryMessage())
            return bool(heard)

        await until(is_heard)
        turns.append(heard[-1])
    assert turns == [1, 2, 1]
    assert set(sources) == {1, 2}


@pytest.mark.parametrize(
    "data", [b"", b"\x00\x01", b"\xff" * 1000, b"\x00\x01\x00\x00" + b"\xff" * 99]
)
async def test_bytes_that_are_no_message_fail_nothing(
    session: Session, node: Any, until: Until, data: bytes
) -> None:
    from nav_msgs.msg import Odometry as OdometryMessage
    from sensor_msgs.msg import BatteryState

    poses: list[float] = []
    levels: list[float] = []
    OdomSubscriber(session, "odom", lambda odometry, *_: poses.append(odometry.pose.x), print)
    BatterySubscriber(session, "battery_state", lambda level, *_: levels.append(level))
    odometry = node.create_publisher(OdometryMessage, "/r2/odom", 10)
    battery = node.create_publisher(BatteryState, "/r2/battery_state", 10)

    def are_taken() -> bool:
        odometry.publish(data)
        odometry.publish(OdometryMessage())
        battery.publish(data)
        battery.publish(BatteryState(percentage=0.5))
        return poses.count(0.0) > 1 and levels.count(0.5) > 1

    await until(are_taken)
    assert all(math.isnan(x) or x == 0.0 for x in poses)


async def test_the_publisher_of_odometry_that_was_silent_longest_is_forgotten(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(odom_subscriber, "MAX_SOURCES", 2)
    heard: list[int] = []
    subscriber = OdomSubscriber(
        session, "odom", lambda odometry, source, sequence: heard.append(source), lambda *_: None
    )
    for gid in (b"a", b"b", b"a", b"c", b"a", b"b"):
        subscriber._receive(b"", 0, 0, 1, gid)
    assert heard == [1, 2, 1, 3, 1, 4]


@pytest.mark.parametrize("percentage", [0.5, 80.0, -1.0, math.nan])
async def test_a_battery_level_is_handed_on_as_it_is_reported(
    session: Session, node: Any, until: Until, percentage: float
) -> None:
    from sensor_msgs.msg import BatteryState

    level = percentage

    levels: list[float] = []
    subscription = BatterySubscriber(
        session, "battery_state", lambda level, *_: levels.append(level)
    )._subscription
    publisher = node.create_publisher(BatteryState, "/r2/battery_state", qos.SENSOR)
    await until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    publisher.publish(BatteryState(percentage=percentage))
    await until(lambda: levels)
    assert levels == pytest.approx([level], nan_ok=True)


async def test_another_frame_of_a_known_publisher_is_told(session: Session) -> None:
    told: list[tuple[int, str]] = []
    subscriber = OdomSubscriber(
        session,
        "odom",
        lambda *_: None,
        lambda source, gid, name, frame: told.append((source, frame)),
    )
    for frame in ("odom", "odom", "map", "map", "x" * 1000):
        subscriber._receive(
            OdometryEncoder(frame, "base_link").encode(ORIGIN, ZERO, 1), 0, 0, 1, b"a"
        )
    assert told[:2] == [(1, "odom"), (1, "map")]
    assert len(told) == 3
    assert len(told[2][1]) <= MAX_NAME


async def test_a_subscriber_that_asks_for_reliable_odometry_gets_it(
    session: Session, node: Any, until: Until
) -> None:
    from nav_msgs.msg import Odometry as OdometryMessage

    wanted = qos.ODOMETRY[OdometryQos.RELIABLE]
    subscriber = OdomSubscriber(session, "odom", lambda *_: None, lambda *_: None, wanted)
    publisher = node.create_publisher(OdometryMessage, "/r2/odom", 10)
    await until(lambda: publisher.get_subscription_count() and subscriber.count_publishers())
    node.destroy_publisher(publisher)


@pytest.mark.parametrize("offered", CommandQos)
async def test_a_base_hears_the_command_with_each_quality_of_service(
    session: Session, executor: Any, node: Any, until: Until, offered: CommandQos
) -> None:
    from geometry_msgs.msg import Twist as TwistMessage

    command = replace(PLAIN, qos=qos.COMMANDS[offered])
    velocity = VelocityPublisher(session, "cmd_vel", command)
    heard: list[Any] = []
    node.create_subscription(
        TwistMessage, "/r2/cmd_vel", lambda message: heard.append(message), command.qos
    )

    def is_heard() -> bool:
        velocity.publish(ZERO)
        return bool(heard)

    await until(is_heard)
