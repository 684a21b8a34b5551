# mypy: disallow-untyped-calls=False
"""Log lines go out on /rosout as those of every node; services tell and set levels."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from rcl_interfaces.msg import LoggerLevel
from rcl_interfaces.srv import GetLoggerLevels, SetLoggerLevels
from rclpy.node import Node

from robotctl.ros.messages import qos
from robotctl.ros.nodes.node_services import MAX_LEVELS, LoggerServices
from robotctl.ros.nodes.publishers import MAX_TEXT, ROSOUT_TOPIC, RosoutLine, RosoutPublisher
from robotctl.ros.session import Session

Until = Callable[[Callable[[], object]], Awaitable[None]]

LINE = RosoutLine(1_700_000_000_123_456_789, 30, "r2.mode_service", "a line", "/a/file.py", "go", 7)


async def test_a_line_has_every_field_and_a_late_subscriber_gets_it(
    session: Session, executor: Any, node: Any, until: Until
) -> None:
    heard: list[Any] = []
    publisher = RosoutPublisher(session)
    publisher.publish(LINE)
    node.create_subscription(
        ROSOUT_TOPIC.message_class, ROSOUT_TOPIC.name, heard.append, qos.ROSOUT
    )
    await until(lambda: heard)
    (told,) = heard
    assert (told.stamp.sec, told.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (told.level, told.name, told.msg) == (30, "r2.mode_service", "a line")
    assert (told.file, told.function, told.line) == ("/a/file.py", "go", 7)
    publisher.publish(RosoutLine(0, 10, "", "x" * (MAX_TEXT + 1), "", "", 0))
    await until(lambda: len(heard) == 2)
    assert heard[1].msg == "x" * MAX_TEXT + " ..."


async def test_rosout_has_the_qos_of_plain_rclpy(
    session: Session, new_context: Any, until: Until
) -> None:
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
