"""Odometry and battery levels are received from publishers of any QoS, and passed on unchanged.

The safety inputs: what a message of each kind means, over ROS.
Scans are received from publishers of any QoS, with the number that the publisher gave them.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from math import inf, isnan
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, Joy
from std_msgs.msg import Bool

from robotctl.base.text import MAX_NAME
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.params import CommandQos, OdometryQos
from robotctl.kernel.safety_inputs import SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import ZERO, Odometry
from robotctl.messages.inputs import MAX_DIAGNOSES, Diagnoses
from robotctl.messages.motion import OdometryEncoder
from robotctl.ros.messages import qos
from robotctl.ros.messages.command_type import PLAIN
from robotctl.ros.nodes import odom_subscriber
from robotctl.ros.nodes.input_subscribers import BatterySubscriber, SafetyInputs, ScanSubscriber
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


def imu(x: float, w: float, covariance: float = 0.0) -> Imu:
    message = Imu()
    message.orientation.x, message.orientation.w = x, w
    message.orientation_covariance[0] = covariance
    return message


def diagnosis(name: str, level: bytes, hardware_id: str = "base") -> DiagnosticArray:
    status = DiagnosticStatus(name=name, level=level, message="hot", hardware_id=hardware_id)
    return DiagnosticArray(status=[status])


MESSAGES: list[tuple[SafetyInput, str, Any, float]] = [
    (SafetyInput.ESTOP, "estop_pressed", Bool(data=True), 1.0),
    (SafetyInput.ESTOP, "estop_pressed", Bool(data=False), 0.0),
    (SafetyInput.JOY, "joy", Joy(buttons=[0, 1]), 1.0),
    (SafetyInput.JOY, "joy", Joy(buttons=[1, 0]), 0.0),
    (SafetyInput.JOY, "joy", Joy(buttons=[1]), float("nan")),
    (SafetyInput.BUMPER, "bumper", Bool(data=True), 1.0),
    (SafetyInput.TILT, "imu", imu(0.0, 1.0), 0.0),
    (SafetyInput.TILT, "imu", imu(0.5**0.5, 0.5**0.5), 1.57),
    (SafetyInput.TILT, "imu", imu(0.0, 0.0), float("nan")),
    (SafetyInput.TILT, "imu", imu(0.0, 1.0, covariance=-1.0), float("nan")),
    (SafetyInput.DIAGNOSTICS, "/diagnostics", diagnosis("motor", DiagnosticStatus.ERROR), 2.0),
    (SafetyInput.DIAGNOSTICS, "/diagnostics", diagnosis("motor", DiagnosticStatus.OK), 0.0),
]


def only(kind: SafetyInput) -> SafetyInputParams:
    params = replace(SafetyInputParams(), joy=replace(SafetyInputParams().joy, button=1))
    changed = {kind.value: replace(params.of(kind), use=Use.OPTIONAL)}
    return replace(params, **changed)  # type: ignore[arg-type]


@pytest.mark.parametrize(("kind", "topic", "message", "value"), MESSAGES)
async def test_a_message_is_read_as_its_type_says(
    session: Session,
    node: Any,
    until: Until,
    kind: SafetyInput,
    topic: str,
    message: Any,
    value: float,
) -> None:
    readings: list[tuple[SafetyInput, float]] = []
    SafetyInputs(session, only(kind), "r2", lambda each, read, *_: readings.append((each, read)))
    full_name = topic if topic.startswith("/") else f"/r2/{topic}"
    publisher = node.create_publisher(type(message), full_name, 10)
    await until(publisher.get_subscription_count)

    def is_heard() -> bool:
        publisher.publish(message)  # best effort: one message may be lost
        return bool(readings)

    await until(is_heard)
    assert readings[0][0] is kind
    assert readings[0][1] == value or (isnan(value) and isnan(readings[0][1]))


def told(diagnoses: Diagnoses, message: DiagnosticArray) -> tuple[float, str]:
    return diagnoses.worst(serialize_message(message))


def test_the_worst_diagnosis_of_all_names_counts_but_for_our_own() -> None:
    diagnoses = Diagnoses("robot")
    assert told(diagnoses, diagnosis("motor", DiagnosticStatus.ERROR)) == (2.0, "motor: hot")
    assert told(diagnoses, diagnosis("laser", DiagnosticStatus.OK)) == (2.0, "motor: hot")
    assert told(diagnoses, diagnosis("motor", DiagnosticStatus.WARN)) == (1.0, "motor: hot")
    own = diagnosis("robot: recorder", DiagnosticStatus.ERROR, "robot")
    assert told(diagnoses, own) == (1.0, "motor: hot")


def test_the_values_of_a_diagnosis_are_passed_over() -> None:
    message = diagnosis("motor", DiagnosticStatus.OK)
    message.status[0].values = [KeyValue(key="x" * n, value="y" * (n + 1)) for n in range(9)]
    message.status += diagnosis("laser", DiagnosticStatus.ERROR).status
    assert told(Diagnoses("robot"), message) == (2.0, "laser: hot")


def test_many_names_do_not_push_an_error_out() -> None:
    diagnoses = Diagnoses("robot")
    told(diagnoses, diagnosis("motor", DiagnosticStatus.ERROR))
    for number in range(2 * MAX_DIAGNOSES):
        message = diagnosis(f"n{number}", DiagnosticStatus.OK)
        assert told(diagnoses, message) == (2.0, "motor: hot")


async def test_a_scan_is_told_by_sectors_with_its_publisher_and_number(
    session: Session, node: Any, until: Until
) -> None:
    from sensor_msgs.msg import LaserScan

    told: list[tuple[tuple[float, ...], str, int]] = []
    ScanSubscriber(session, "scan", lambda *scan: told.append(scan))
    publisher = node.create_publisher(LaserScan, "/r2/scan", qos.SENSOR)
    scan = LaserScan(angle_increment=0.01, range_min=0.1, range_max=10.0, ranges=[1.5])

    def is_told() -> bool:
        publisher.publish(scan if told else b"")
        return len(told) > 1 and told[-1][0] != ()

    await until(is_told)
    assert told[0][0] == ()
    sectors, gid, sequence = told[-1]
    assert min(sectors) == 1.5
    assert sectors.count(inf) == 63
    assert len(gid) == 32
    assert sequence > told[0][2] > 0
