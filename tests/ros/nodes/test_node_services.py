"""Log lines go out on /rosout as those of every node; services tell and set levels.

The parameter services of a node take any request, and ask for what rclpy would grant.
The mode service passes requests to the kernel, returns its replies, and shows the status.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Sequence
from typing import Any

import pytest
from rcl_interfaces.msg import LoggerLevel, ParameterValue
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import (
    GetLoggerLevels,
    SetLoggerLevels,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.node import Node
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode
from std_srvs.srv import Trigger

from robotctl.config import Declaration, Kind
from robotctl.kernel.modes import Mode
from robotctl.kernel.ranges import Change, Range
from robotctl.kernel.types import Reply
from robotctl.ros import qos
from robotctl.ros.graph import endpoints
from robotctl.ros.nodes import mode_service
from robotctl.ros.nodes.mode_service import ModeService
from robotctl.ros.nodes.node_services import MAX_LEVELS, LoggerServices, ParameterServices
from robotctl.ros.nodes.publishers import MAX_TEXT, ROSOUT_TOPIC, RosoutPublisher
from robotctl.ros.session import Session
from tests.support.waiting import loop_until as until

LINE = logging.LogRecord("robotctl", 30, "/a/file.py", 7, "a line", None, None, func="go")


async def test_a_line_has_every_field_and_a_late_subscriber_gets_it(
    session: Session, executor: Any, node: Any
) -> None:
    heard: list[Any] = []
    publisher = RosoutPublisher(session)
    LINE.created = 1_700_000_000.5
    publisher.publish(LINE, 30, "r2.mode_service", "a line")
    node.create_subscription(
        ROSOUT_TOPIC.message_class, ROSOUT_TOPIC.name, heard.append, qos.ROSOUT
    )
    await until(lambda: heard)
    (told,) = heard
    assert (told.stamp.sec, told.stamp.nanosec) == (1_700_000_000, 500_000_000)
    assert (told.level, told.name, told.msg) == (30, "r2.mode_service", "a line")
    assert (told.file, told.function, told.line) == ("/a/file.py", "go", 7)
    publisher.publish(LINE, 10, "", "x" * (MAX_TEXT + 1))
    await until(lambda: len(heard) == 2)
    assert heard[1].msg == "x" * MAX_TEXT + " ..."


async def test_rosout_has_the_qos_of_plain_rclpy(session: Session, new_context: Any) -> None:
    RosoutPublisher(session)
    plain = Node("plain", context=new_context())

    def offered() -> dict[str, Any]:
        return {each.node_name: each for each in plain.get_publishers_info_by_topic("/rosout")}

    await until(lambda: {"_recorder", "plain"} <= set(offered()))
    ours, theirs = offered()["_recorder"], offered()["plain"]
    assert (ours.topic_type, ours.qos_profile) == (theirs.topic_type, theirs.qos_profile)
    plain.destroy_node()


async def test_the_services_of_a_node_tell_and_set_levels(
    session: Session, executor: Any, node: Any
) -> None:
    levels = {"": 20}

    def change(name: str, level: int, source: str) -> str:
        if level == 25:
            return "no"
        levels[name] = level
        sources.append(source)
        return ""

    sources: list[str] = []
    LoggerServices(session.node("mode_service"), lambda name: levels.get(name, 0), change)
    getting = node.create_client(GetLoggerLevels, "/r2/mode_service/get_logger_levels")
    setting = node.create_client(SetLoggerLevels, "/r2/mode_service/set_logger_levels")
    for each in (getting, setting):
        await executor.wait_for_service(each, timeout_s=30.0)
    wanted = [LoggerLevel(name="a", level=10), LoggerLevel(name="b", level=25)]
    answer = await executor.call(setting, SetLoggerLevels.Request(levels=wanted), timeout_s=30.0)
    assert [(each.successful, each.reason) for each in answer.results] == [
        *((True, ""), (False, "no"))
    ]
    assert sources == ["the ROS service /r2/mode_service/set_logger_levels"]
    request = GetLoggerLevels.Request(names=["", "a", "b"])
    answer = await executor.call(getting, request, timeout_s=30.0)
    assert [(each.name, each.level) for each in answer.levels] == [("", 20), ("a", 10), ("b", 0)]
    wanted = [LoggerLevel(name=f"n{number}", level=10) for number in range(MAX_LEVELS + 2)]
    answer = await executor.call(setting, SetLoggerLevels.Request(levels=wanted), timeout_s=30.0)
    assert len(answer.results) == MAX_LEVELS + 2
    assert f"n{MAX_LEVELS}" not in levels
    assert answer.results[-1].reason == f"more than {MAX_LEVELS} levels in one call"


NOW, START = Change.STANDING, Change.START
LIMITS = Range(0.0, 1.0, "m/s")
DECLARED: tuple[tuple[Declaration, Any], ...] = (
    (Declaration("speed", Kind.NUMBER, 0.6, "a speed", "0 to 1 m/s", NOW, LIMITS), 0.6),
    (Declaration("number", Kind.INTEGER, 3, "a number", "0 to 9", NOW, Range(0, 9)), 3),
    (Declaration("topics", Kind.TEXTS, [], "topics", "a list", START, None), []),
)


class Asked:
    """Keeps what was asked, and refuses what it is told to."""

    def __init__(self) -> None:
        self.settings: list[tuple[str, Any]] = []
        self.refusal = ""

    def __call__(self, settings: Sequence[tuple[str, Any]], source: str) -> str:
        self.settings += settings
        assert source == "the ROS service /r2/some_node/set_parameters"
        return self.refusal


def served(session: Session) -> tuple[ParameterServices, Asked, Any]:
    asked, node = Asked(), session.node("some_node")
    return ParameterServices(node, DECLARED, asked), asked, node


def speed(value: float) -> ParameterMessage:
    return ParameterMessage(name="speed", value=ParameterValue(type=3, double_value=value))


async def test_a_value_of_a_type_that_does_not_exist_is_refused(session: Session) -> None:
    services, asked, _ = served(session)
    odd = ParameterMessage(name="speed", value=ParameterValue(type=99))
    deleted = ParameterMessage(name="speed", value=ParameterValue(type=0))
    request = SetParameters.Request(parameters=[odd, deleted, ParameterMessage(name="\x1b[2J")])
    response = services._set_one_by_one(request, SetParameters.Response())
    assert [each.successful for each in response.results] == [False, False, False]
    assert "\x1b" not in response.results[2].reason
    assert asked.settings == []


async def test_a_refusal_keeps_the_value_and_a_grant_takes_it(session: Session) -> None:
    services, asked, node = served(session)
    asked.refusal = "not now"
    request = SetParametersAtomically.Request(parameters=[speed(0.5)])
    refused = services._set_all_or_none(request, SetParametersAtomically.Response()).result
    assert (refused.successful, refused.reason) == (False, "not now")
    assert node.get_parameter("speed").value == 0.6
    asked.refusal = ""
    assert services._set_all_or_none(request, SetParametersAtomically.Response()).result.successful
    assert node.get_parameter("speed").value == 0.5
    assert asked.settings == [("speed", 0.5), ("speed", 0.5)]


async def test_a_value_that_changed_otherwise_is_shown_without_being_asked_for(
    session: Session,
) -> None:
    services, asked, node = served(session)
    services.show("number", 4)
    services.show("another key", 4)
    assert (node.get_parameter("number").value, asked.settings) == (4, [])
    assert node.get_parameter("topics").value == []


def replied(reply: Reply) -> asyncio.Future[Reply]:
    """Return a reply that is there at once."""
    future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
    future.set_result(reply)
    return future


async def test_the_status_is_shown_to_whoever_comes_late(
    session: Session, executor: Any, node: Any
) -> None:
    service = ModeService(session, "r2", lambda requested, source: asyncio.Future())
    service.publish(Mode.ERROR, math.nan, False)
    service.publish(Mode.MOVING, 0.75, True)
    shown: list[Any] = []
    node.create_subscription(RobotStatus, service.status_topic, shown.append, qos.LATCHED)
    await until(lambda: shown)
    (status,) = shown
    assert (status.robot_name, status.mode, status.battery_level) == ("r2", 1, 0.75)
    assert status.is_connected is True
    assert math.isnan(status.cpu_temperature) or -50.0 < status.cpu_temperature < 150.0


@pytest.mark.parametrize(
    ("service", "request_of", "mode"),
    [("set_mode", SetMode.Request(requested_mode=200), 200), ("estop", Trigger.Request(), 3)],
)
async def test_a_call_is_answered_with_what_was_decided(
    session: Session, executor: Any, node: Any, service: str, request_of: Any, mode: int
) -> None:
    asked: list[tuple[int, str]] = []

    def refuse(requested: int, source: str) -> asyncio.Future[Reply]:
        asked.append((requested, source))
        return replied(Reply(1, False, "because", Mode.EMERGENCY_STOP))

    ModeService(session, "r2", refuse, lambda reply: reply.message.upper())
    client = node.create_client(SetMode if mode == 200 else Trigger, f"/r2/{service}")
    await executor.wait_for_service(client, timeout_s=20.0)
    answer = await executor.call(client, request_of, timeout_s=20.0)
    assert (answer.success, answer.message) == (False, "BECAUSE")
    assert getattr(answer, "current_mode", 3) == 3
    assert asked == [(mode, f"the ROS service /r2/{service}")]


async def test_requests_beyond_the_limit_are_refused_as_busy_and_stops_are_not(
    session: Session, executor: Any, node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mode_service, "MAX_IN_WORK", 3)
    pending: list[asyncio.Future[Reply]] = []

    def wait(requested: int, source: str) -> asyncio.Future[Reply]:
        pending.append(asyncio.get_running_loop().create_future())
        return pending[-1] if requested != 3 else replied(Reply(1, True, "", Mode.EMERGENCY_STOP))

    service = ModeService(session, "r2", wait)
    service.publish(Mode.MOVING, 1.0, True)
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


async def test_what_the_mode_service_publishes_is_what_it_declares(session: Session) -> None:
    service = ModeService(session, "r2", lambda mode, source: asyncio.Future())
    for topic in (mode_service.STATUS, *mode_service.CALLS):
        (found,) = endpoints.publishers(service.node, session.resolve(topic.name))
        offered = found.qos_profile
        assert found.topic_type == topic.type_name
        assert offered.durability is topic.qos.durability
        assert offered.reliability is topic.qos.reliability
