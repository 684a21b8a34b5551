"""Odometry and battery levels are received from publishers of any QoS, and passed on unchanged.

The safety inputs: what a message of each kind means, over ROS.
Scans: the nearest ranges by direction, as LaserScan and REP-117 define them, with the publisher.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from math import inf, nan, tau
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist as TwistMessage
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState, Imu, Joy, LaserScan
from std_msgs.msg import Bool

from robotctl.base.text import MAX_NAME
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.params import CommandQos
from robotctl.kernel.safety_inputs import SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import ZERO, Odometry
from robotctl.messages.inputs import (
    MAX_DIAGNOSES,
    MAX_RAYS,
    SECTORS,
    Diagnoses,
    OdometryEncoder,
    nearest_by_sector,
)
from robotctl.ros import qos
from robotctl.ros.message_types import COMMANDS, PLAIN
from robotctl.ros.nodes import odom_subscriber
from robotctl.ros.nodes.input_subscribers import report_battery, report_safety_inputs, report_scans
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.ros.session import Session
from tests.support.waiting import loop_until as until


@pytest.mark.parametrize("offered", [qos.SENSOR, qos.COMMAND, qos.LATCHED])
async def test_odometry_of_any_quality_of_service_is_taken(
    session: Session, node: Any, offered: Any
) -> None:
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
    session: Session, node: Any
) -> None:
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


async def test_bytes_that_are_no_message_fail_nothing(session: Session, node: Any) -> None:
    poses: list[float] = []
    levels: list[float] = []
    OdomSubscriber(session, "odom", lambda odometry, *_: poses.append(odometry.pose.x), print)
    report_battery(session, "battery_state", lambda level, *_: levels.append(level))
    odometry = node.create_publisher(OdometryMessage, "/r2/odom", 10)
    battery = node.create_publisher(BatteryState, "/r2/battery_state", 10)
    for data in (b"", b"\x00\x01", b"\xff" * 1000, b"\x00\x01\x00\x00" + b"\xff" * 99):
        seen = poses.count(0.0), levels.count(0.5)

        def are_taken(data: bytes = data, seen: tuple[int, int] = seen) -> bool:
            odometry.publish(data)
            odometry.publish(OdometryMessage())
            battery.publish(data)
            battery.publish(BatteryState(percentage=0.5))
            return poses.count(0.0) > seen[0] + 1 and levels.count(0.5) > seen[1] + 1

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


async def test_a_battery_level_is_handed_on_as_it_is_reported(session: Session, node: Any) -> None:
    levels: list[float] = []
    subscription = report_battery(session, "battery_state", lambda level, *_: levels.append(level))
    publisher = node.create_publisher(BatteryState, "/r2/battery_state", qos.SENSOR)
    await until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    reported = [0.5, 80.0, -1.0, math.nan]
    for level in reported:
        publisher.publish(BatteryState(percentage=level))
    await until(lambda: len(levels) == len(reported))
    assert levels == pytest.approx(reported, nan_ok=True)


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


@pytest.mark.parametrize("offered", CommandQos)
async def test_a_base_hears_the_command_with_each_quality_of_service(
    session: Session, executor: Any, node: Any, offered: CommandQos
) -> None:
    command = replace(PLAIN, qos=COMMANDS[offered])
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
    (SafetyInput.ESTOP, "/r2/estop_pressed", Bool(data=True), 1.0),
    (SafetyInput.ESTOP, "/r2/estop_pressed", Bool(data=False), 0.0),
    (SafetyInput.JOY, "/r2/joy", Joy(buttons=[0, 1]), 1.0),
    (SafetyInput.JOY, "/r2/joy", Joy(buttons=[1, 0]), 0.0),
    (SafetyInput.JOY, "/r2/joy", Joy(buttons=[1]), float("nan")),
    (SafetyInput.BUMPER, "/r2/bumper", Bool(data=True), 1.0),
    (SafetyInput.TILT, "/r2/imu", imu(0.0, 1.0), 0.0),
    (SafetyInput.TILT, "/r2/imu", imu(0.0, 0.0), float("nan")),
    (SafetyInput.TILT, "/r2/imu", imu(0.5**0.5, 0.5**0.5), 1.57),
    (SafetyInput.TILT, "/r2/imu", imu(0.0, 1.0, covariance=-1.0), float("nan")),
    (SafetyInput.DIAGNOSTICS, "/diagnostics", diagnosis("motor", DiagnosticStatus.ERROR), 2.0),
    (SafetyInput.DIAGNOSTICS, "/diagnostics", diagnosis("motor", DiagnosticStatus.OK), 0.0),
]


async def test_a_message_is_read_as_its_type_says(session: Session, node: Any) -> None:
    params = SafetyInputParams()
    used: Any = {kind.value: replace(params.of(kind), use=Use.OPTIONAL) for kind in SafetyInput}
    params = replace(params, **used | {"joy": replace(used["joy"], button=1)})
    readings: list[tuple[SafetyInput, float]] = []
    report_safety_inputs(session, params, "r2", lambda *told: readings.append(told[:2]))
    known: list[Any] = [(kind, pytest.approx(value, nan_ok=True)) for kind, _, _, value in MESSAGES]
    for expected, (_, topic, message, _) in zip(known, MESSAGES, strict=True):
        publisher = node.create_publisher(type(message), topic, 10)
        seen = len(readings)

        def is_heard(publisher: Any = publisher, message: Any = message) -> bool:
            publisher.publish(message)  # best effort: one message may be lost
            return expected in readings[seen:]  # noqa: B023

        await until(is_heard)
        node.destroy_publisher(publisher)
    assert all(each in known for each in readings)


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
    session: Session, node: Any
) -> None:
    told: list[tuple[tuple[float, ...], str, int]] = []
    report_scans(session, "scan", lambda *scan: told.append(scan))
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


def scan(ranges: list[float], angle_min: float = -3.13, **fields: float) -> bytes:
    increment = tau / max(len(ranges), 1)
    message = LaserScan(
        angle_min=angle_min, angle_increment=increment, range_min=0.1, range_max=10.0
    )
    message.ranges = ranges
    message.header.frame_id = "laser"
    for name, value in fields.items():
        setattr(message, name, value)
    return serialize_message(message)


@pytest.mark.parametrize(
    ("value", "nearest"),
    [(1.5, 1.5), (0.05, inf), (0.0, inf), (11.0, inf), (nan, inf), (inf, inf), (-inf, 0.0)],
)
def test_a_range_means_what_the_message_and_rep_117_say(value: float, nearest: float) -> None:
    assert nearest_by_sector(scan([value])) == (nearest, *[inf] * (SECTORS - 1))


def test_each_direction_has_its_sector() -> None:
    ranges = [1.0 + number / 100 for number in range(4 * SECTORS)]
    nearest = nearest_by_sector(scan(ranges))
    assert nearest == tuple(pytest.approx(1.0 + n / 25, abs=0.02) for n in range(SECTORS))


@given(st.lists(st.floats(width=32), max_size=200), st.floats(-20, 20, width=32))
def test_any_ranges_give_as_many_numbers_and_never_nan(ranges: list[float], angle: float) -> None:
    nearest = nearest_by_sector(scan(ranges, angle))
    assert len(nearest) == SECTORS
    assert all(each >= 0.0 for each in nearest)


def test_a_hundred_thousand_rays_are_read() -> None:
    assert min(nearest_by_sector(scan([2.0] * 100_000))) == 2.0


# Named, for rmw leaves the padding of a message as it was: each process has other bytes there.
@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"", id="empty"),
        pytest.param(scan([1.0])[:-9], id="cut"),
        pytest.param(scan([1.0], angle_min=nan), id="begins nowhere"),
        pytest.param(scan([1.0], angle_increment=inf), id="endless step"),
        pytest.param(scan([1.0] * (MAX_RAYS + 1)), id="too many rays"),
    ],
)
def test_what_is_no_scan_is_refused(data: bytes) -> None:
    with pytest.raises(struct.error):
        nearest_by_sector(data)
