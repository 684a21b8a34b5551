"""Each role on real rclpy: it converts and forwards, and decides nothing."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import ExitStack
from typing import Any

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Odometry, Reply, Twist
from robotctl.recording.format import journal
from robotctl.ros.graph import endpoints
from robotctl.ros.messages import qos
from robotctl.ros.nodes import (
    journal_publisher,
    mode_service,
    odom_subscriber,
    velocity_publisher,
)
from robotctl.ros.nodes.battery_subscriber import BatterySubscriber
from robotctl.ros.nodes.diagnostics_publisher import TOPIC, Diagnosis, DiagnosticsPublisher, Level
from robotctl.ros.nodes.mode_service import ModeService, Shown
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.ros.playback.playback import DAEMON_TYPE
from robotctl.ros.session import Session, ros_session
from robotctl.sim.robot import SimParams

Until = Callable[[Callable[[], object]], Awaitable[None]]


@pytest.fixture
async def session(domain_id: int) -> AsyncIterator[Session]:
    """A session like the daemon's, in a namespace of its own."""
    with ExitStack() as at_end:
        async with ros_session(domain_id=domain_id, namespace="/r2", at_end=at_end) as made:
            yield made


@pytest.fixture
async def heard(executor: Any, node: Any) -> list[tuple[float, float]]:
    """The commands that another node receives."""
    from geometry_msgs.msg import Twist as TwistMessage

    commands: list[tuple[float, float]] = []
    node.create_subscription(
        TwistMessage,
        "/r2/cmd_vel",
        lambda message: commands.append((message.linear.x, message.angular.z)),
        100,
    )
    return commands


# The velocity command


async def test_a_command_is_sent_as_it_is(
    session: Session, heard: list[tuple[float, float]], until: Until
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    await until(velocity._publisher.get_subscription_count)
    velocity.publish(Twist(0.25, -1.5))
    await until(lambda: heard)
    assert (heard, velocity.published, velocity.topic) == ([(0.25, -1.5)], 1, "/r2/cmd_vel")


async def test_a_closed_gate_lets_zeros_through_only(
    session: Session, heard: list[tuple[float, float]], until: Until
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
    await until(lambda: len(heard) == 3)
    assert heard == [(0.0, 0.0), (0.0, 0.0), (0.5, 0.0)]
    assert velocity.published == 3


async def test_a_zero_does_not_wait_for_a_publication_that_hangs(session: Session) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    with velocity._lock, pytest.raises(TimeoutError, match="hangs"):
        velocity.publish_zero()


async def test_only_others_count_as_foreign_publishers(
    session: Session, node: Any, until: Until
) -> None:
    from geometry_msgs.msg import Twist as TwistMessage

    velocity = VelocityPublisher(session, "cmd_vel")
    await until(lambda: velocity.count_publishers() == 1)
    assert velocity.other_publishers() == ()
    node.create_publisher(TwistMessage, "/r2/cmd_vel", 10)
    await until(lambda: velocity.other_publishers() == ("/tested",))


async def test_a_second_node_of_our_name_is_foreign(
    session: Session, new_context: Callable[[], Any], until: Until
) -> None:
    from geometry_msgs.msg import Twist as TwistMessage
    from rclpy.node import Node

    velocity = VelocityPublisher(session, "cmd_vel")
    impostor = Node("velocity_publisher", namespace="/r2", context=new_context())
    impostor.create_publisher(TwistMessage, "cmd_vel", 10)
    await until(lambda: velocity.other_publishers() == ("/r2/velocity_publisher",))
    impostor.destroy_node()


# Odometry and battery


@pytest.mark.parametrize("offered", [qos.SENSOR, qos.COMMAND, qos.LATCHED])
async def test_odometry_of_any_quality_of_service_is_taken(
    session: Session, node: Any, until: Until, offered: Any
) -> None:
    from nav_msgs.msg import Odometry as OdometryMessage

    measured: list[tuple[Odometry, int, int]] = []
    sources: list[tuple[int, str, str]] = []
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
    message.header.stamp.sec, message.header.stamp.nanosec = 2, 3
    publisher.publish(message)
    await until(lambda: measured)
    ((odometry, source, sequence),) = measured
    assert (source, sequence) == (1, 1)

    def is_named() -> bool:
        subscriber.find_names()
        return sources[-1][2] != ""

    await until(is_named)
    assert [(number, len(gid)) for number, gid, _ in sources] == len(sources) * [(1, 32)]
    assert sources[-1][2] == "/tested"
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
        lambda source, gid, name: sources.append(source),
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
    BatterySubscriber(session, "battery_state", levels.append)
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


async def test_of_many_other_publishers_some_are_named_and_the_rest_counted(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    velocity = VelocityPublisher(session, "cmd_vel")
    others = [
        endpoints.Endpoint(f"{number:03}{'x' * 400}", "/", "t", b"%d" % number, qos.COMMAND)
        for number in range(600)
    ]
    monkeypatch.setattr(endpoints, "publishers", lambda node, topic: others)
    names = velocity.other_publishers()
    assert names[-1] == "592 more"
    assert len("".join(names)) < 2_000


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


async def test_who_takes_the_command_is_counted_by_type_and_without_recorders(
    session: Session, node: Any, new_context: Callable[[], Any], until: Until
) -> None:
    from geometry_msgs.msg import Twist as TwistMessage
    from geometry_msgs.msg import TwistStamped
    from rclpy.node import Node

    velocity = VelocityPublisher(session, "cmd_vel")
    recorder = session.node("recorder")
    recorder.create_subscription(TwistMessage, "cmd_vel", print, 10)
    another = Node("recorder", namespace="/r3", context=session._context)
    another.create_subscription(TwistMessage, "/r2/cmd_vel", print, 10)
    velocity.monitor(lambda gid: None, 0.0)
    await until(lambda: velocity.count_listeners() == 3)
    assert velocity.listeners() == (0, ())
    node.create_subscription(TwistMessage, "/r2/cmd_vel", print, 10)
    await until(lambda: velocity.listeners() == (1, ()))
    stamped = Node("stamped", context=new_context())  # Fast DDS: one type a topic and context
    stamped.create_subscription(TwistStamped, "/r2/cmd_vel", print, 10)
    await until(lambda: velocity.listeners() == (1, ("geometry_msgs/msg/TwistStamped",)))
    stamped.destroy_node()
    another.destroy_node()


async def test_a_robot_that_takes_another_type_is_no_listener_and_its_type_is_named(
    session: Session, new_context: Callable[[], Any], until: Until
) -> None:
    from geometry_msgs.msg import TwistStamped
    from rclpy.node import Node

    velocity = VelocityPublisher(session, "cmd_vel")
    stamped = Node("stamped", context=new_context())
    stamped.create_subscription(TwistStamped, "/r2/cmd_vel", print, 10)
    await until(lambda: velocity.listeners() == (0, ("geometry_msgs/msg/TwistStamped",)))
    stamped.destroy_node()


async def test_the_identity_of_our_commands_is_asked_once(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []

    def gid_of(publisher: object) -> bytes:
        asked.append(publisher)
        return b"gid"

    monkeypatch.setattr(velocity_publisher, "gid_of", gid_of)
    velocity = VelocityPublisher(session, "cmd_vel")
    for _ in range(3):
        assert velocity.gid == b"gid"
        velocity.other_publishers()
    assert len(asked) == 1


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
    BatterySubscriber(session, "battery_state", lambda _: None)
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


@pytest.mark.parametrize("percentage", [0.5, 80.0, -1.0, math.nan])
async def test_a_battery_level_is_handed_on_as_it_is_reported(
    session: Session, node: Any, until: Until, percentage: float
) -> None:
    from sensor_msgs.msg import BatteryState

    level = percentage

    levels: list[float] = []
    subscription = BatterySubscriber(session, "battery_state", levels.append)._subscription
    publisher = node.create_publisher(BatteryState, "/r2/battery_state", qos.SENSOR)
    await until(lambda: publisher.get_subscription_count() and subscription.get_publisher_count())
    publisher.publish(BatteryState(percentage=percentage))
    await until(lambda: levels)
    assert levels == pytest.approx([level], nan_ok=True)


# The mode


def replied(reply: Reply) -> asyncio.Future[Reply]:
    """Return a reply that is there at once."""
    future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
    future.set_result(reply)
    return future


async def test_the_status_is_shown_to_whoever_comes_late(
    session: Session, executor: Any, node: Any, until: Until
) -> None:
    from robot_controller.msg import RobotStatus

    service = ModeService(session, "r2", lambda requested, source: asyncio.Future())
    service.publish(Shown(Mode.ERROR, math.nan, False))
    service.publish(Shown(Mode.MOVING, 0.75, True))
    shown: list[Any] = []
    node.create_subscription(RobotStatus, service.status_topic, shown.append, qos.LATCHED)
    await until(lambda: shown)
    (status,) = shown
    assert (status.robot_name, status.mode, status.battery_level) == ("r2", 1, 0.75)
    assert status.is_connected is True
    assert math.isnan(status.cpu_temperature) or -50.0 < status.cpu_temperature < 150.0


async def test_a_call_is_answered_with_what_was_decided(
    session: Session, executor: Any, node: Any
) -> None:
    from robot_controller.srv import SetMode

    asked: list[tuple[int, str]] = []

    def refuse(requested: int, source: str) -> asyncio.Future[Reply]:
        asked.append((requested, source))
        return replied(Reply(1, False, "because", Mode.EMERGENCY_STOP))

    ModeService(session, "r2", refuse, lambda reply: reply.message.upper())
    client = node.create_client(SetMode, "/r2/set_mode")
    await executor.wait_for_service(client, timeout_s=20.0)
    answer = await executor.call(client, SetMode.Request(requested_mode=200), timeout_s=20.0)
    assert (answer.success, answer.message, answer.current_mode) == (False, "BECAUSE", 3)
    assert asked == [(200, "the ROS service /r2/set_mode")]


async def test_a_call_of_estop_asks_for_an_emergency_stop(
    session: Session, executor: Any, node: Any
) -> None:
    from std_srvs.srv import Trigger

    asked: list[tuple[int, str]] = []

    def stop(requested: int, source: str) -> asyncio.Future[Reply]:
        asked.append((requested, source))
        return replied(Reply(1, True, "stopped", Mode.EMERGENCY_STOP))

    ModeService(session, "r2", stop)
    client = node.create_client(Trigger, "/r2/estop")
    await executor.wait_for_service(client, timeout_s=20.0)
    answer = await executor.call(client, Trigger.Request(), timeout_s=20.0)
    assert (answer.success, answer.message) == (True, "stopped")
    assert asked == [(3, "the ROS service /r2/estop")]


async def test_requests_beyond_the_limit_are_refused_as_busy_and_stops_are_not(
    session: Session, executor: Any, node: Any, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    from robot_controller.srv import SetMode
    from std_srvs.srv import Trigger

    monkeypatch.setattr(mode_service, "MAX_IN_WORK", 3)
    pending: list[asyncio.Future[Reply]] = []

    def wait(requested: int, source: str) -> asyncio.Future[Reply]:
        pending.append(asyncio.get_running_loop().create_future())
        return pending[-1] if requested != 3 else replied(Reply(1, True, "", Mode.EMERGENCY_STOP))

    service = ModeService(session, "r2", wait)
    service.publish(Shown(Mode.MOVING, 1.0, True))
    set_mode = node.create_client(SetMode, "/r2/set_mode")
    estop = node.create_client(Trigger, "/r2/estop")
    for client in (set_mode, estop):
        await executor.wait_for_service(client, timeout_s=20.0)

    def ask(mode: int) -> asyncio.Task[Any]:
        request = SetMode.Request(requested_mode=mode)
        return asyncio.create_task(executor.call(set_mode, request, timeout_s=20.0))

    waiting = [ask(0) for _ in range(3)]
    await asyncio.sleep(0)  # until the calls are made
    refused = await ask(0)
    assert (refused.success, refused.current_mode) == (False, 1)
    assert refused.message == "busy: 3 requests wait for their reply; try again"
    assert (await ask(3)).success
    assert (await executor.call(estop, Trigger.Request(), timeout_s=20.0)).success
    for future in pending[:3]:
        future.set_result(Reply(1, True, "done", Mode.IDLE))
    assert [(await call).message for call in waiting] == ["done"] * 3
    again = ask(0)
    await until(lambda: len(pending) == 6)
    pending[-1].set_result(Reply(1, True, "taken again", Mode.IDLE))
    assert (await again).message == "taken again"


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
    subscription = node.create_subscription(DiagnosticArray, TOPIC.name, heard.append, 10)
    await until(subscription.get_publisher_count)
    await until(diagnostics._publisher.get_subscription_count)
    diagnostics.publish(
        Diagnosis("recorder", Level.WARN, "no \x1b[31m", {"file": "/data/\udcff.mcap"})
    )
    await until(lambda: heard)
    (status,) = heard[0].status
    assert (status.message, status.values[0].value) == ("no \\x1b[31m", "/data/\\udcff.mcap")


# The topics that they declare


async def test_what_the_mode_service_publishes_is_what_it_declares(session: Session) -> None:
    service = ModeService(session, "r2", lambda mode, source: asyncio.Future())
    for topic in (mode_service.STATUS, *mode_service.CALLS):
        (found,) = endpoints.publishers(service._node, session.resolve(topic.name))
        offered = found.qos_profile
        assert found.topic_type == topic.type_name
        assert offered.durability is topic.qos.durability
        assert offered.reliability is topic.qos.reliability


def test_the_journal_is_declared_as_readers_and_replays_look_for_it() -> None:
    declared = journal_publisher.TOPIC
    assert (declared.name, declared.type_name) == (journal.TOPIC, journal.TYPE_NAME)
    assert declared.type_name == DAEMON_TYPE
