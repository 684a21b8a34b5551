"""The tap records every topic of any publisher, and names the ones that it cannot record."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from threading import Event
from typing import Any

import pytest
import yaml

from robotctl.ros.messages import qos
from robotctl.ros.messages.classes import OwnTopic
from robotctl.ros.messages.type_definition import definition_of, holds_bytes, type_hash_of
from robotctl.ros.session import Session
from robotctl.ros.tap import type_loader
from robotctl.ros.tap.subscription import TappedSubscription
from robotctl.ros.tap.tap import Tap

Until = Callable[[Callable[[], object]], Awaitable[None]]


def publisher(node: Any, topic: str, profile: Any = 10, kind: Any = None) -> Any:
    from std_msgs.msg import UInt64

    return node.create_publisher(kind or UInt64, topic, profile)


def number(value: int) -> Any:
    from std_msgs.msg import UInt64

    return UInt64(data=value)


async def test_a_foreign_topic_is_taken_with_all_that_describes_it(
    taken: Any, node: Any, topic: str, until: Until
) -> None:
    published = publisher(node, topic)
    await until(published.get_subscription_count)
    for value in (7, 8):
        published.publish(number(value))
    await until(lambda: len(taken.messages[topic]) == 2)
    assert taken.values(topic) == [7, 8]
    described = taken.topics[topic]
    assert described.type_name == "std_msgs/msg/UInt64"
    assert "uint64 data" in described.definition
    (info,) = node.get_publishers_info_by_topic(topic)
    assert described.type_hash == str(info.topic_type_hash)
    assert yaml.safe_load(described.offered_qos)[0]["reliability"] == "reliable"
    received = [
        (at_ns >= sent_ns > 0, count) for _, at_ns, sent_ns, count, _ in taken.messages[topic]
    ]
    assert received == [(True, 1), (True, 2)]


async def test_our_own_topic_is_taken_from_its_first_message(
    session: Session, new_taken: Callable[[], Any], topic: str, until: Until
) -> None:
    from std_msgs.msg import UInt64

    taken = new_taken()
    Tap(session, taken.open).subscribe_own(OwnTopic(topic, UInt64, qos.COMMAND))
    publisher(session.node("ours"), topic).publish(number(1))
    await until(lambda: taken.messages[topic])
    assert [message[3] for message in taken.messages[topic]] == [1]


async def test_a_publisher_that_offers_less_is_taken_as_well(
    taken: Any, node: Any, topic: str, until: Until
) -> None:
    reliable = publisher(node, topic)
    await until(reliable.get_subscription_count)
    weaker = publisher(node, topic, qos.SENSOR)
    await until(lambda: weaker.get_subscription_count() and reliable.get_subscription_count())
    weaker.publish(number(5))
    reliable.publish(number(6))
    await until(lambda: {5, 6} <= set(taken.values(topic)))


async def test_a_latched_message_from_before_is_taken(
    taken: Any, node: Any, topic: str, until: Until
) -> None:
    publisher(node, topic, qos.LATCHED).publish(number(9))
    await until(lambda: topic in taken.messages and taken.messages[topic])
    assert taken.values(topic) == [9]


async def test_what_nobody_publishes_and_what_comes_otherwise_are_not_subscribed_to(
    taken: Any, node: Any, topic: str, until: Until
) -> None:
    from std_msgs.msg import UInt64

    node.create_subscription(UInt64, f"{topic}_listened", print, 10)
    sink = taken.tap.reserve(OwnTopic("/reserved", UInt64, qos.COMMAND))
    reserved = publisher(node, "/reserved")
    publisher(node, topic)
    await until(lambda: topic in taken.topics)
    assert f"{topic}_listened" not in taken.topics
    assert reserved.get_subscription_count() == 0
    sink(b"", 1, 2, 3, b"")
    assert taken.messages["/reserved"] == [(b"", 1, 2, 3, b"")]


async def test_a_type_that_is_not_installed_is_named_and_the_others_go_on(
    taken: Any,
    node: Any,
    topic: str,
    until: Until,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    from std_msgs.msg import String

    load = type_loader.load_type

    def missing(type_name: str) -> str:
        return "is not installed" if type_name == "std_msgs/msg/String" else load(type_name)

    monkeypatch.setattr(type_loader, "load_type", missing)
    problems = taken.tap.unrecorded.problems
    told = (
        f"{topic}_foreign is not recorded: it has type std_msgs/msg/String, which is not installed"
    )
    for _ in range(2):  # it comes and goes
        foreign = publisher(node, f"{topic}_foreign", kind=String)
        await until(lambda: problems == {f"{topic}_foreign": told})
        node.destroy_publisher(foreign)
        await until(lambda: not problems)
    publisher(node, topic)
    await until(lambda: topic in taken.topics)
    assert caplog.messages.count(told) == 1


async def test_a_subscription_that_fails_is_named_and_the_others_go_on(
    taken: Any, node: Any, topic: str, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    create = TappedSubscription._create

    def failing(self: TappedSubscription, sink: Any, requested: Any) -> Any:
        if self.topic.endswith("_bad"):
            raise RuntimeError("injected")
        return create(self, sink, requested)

    monkeypatch.setattr(TappedSubscription, "_create", failing)
    publisher(node, f"{topic}_bad")
    problems = taken.tap.unrecorded.problems
    await until(lambda: problems)
    publisher(node, topic)
    await until(lambda: topic in taken.topics)
    assert "cannot be subscribed to (RuntimeError: injected)" in problems[f"{topic}_bad"]


async def test_a_topic_that_cannot_be_followed_for_a_while_is_named_until_it_can(
    taken: Any, node: Any, topic: str, until: Until, no_subscription: Event
) -> None:
    reliable = publisher(node, topic)
    await until(reliable.get_subscription_count)
    no_subscription.set()
    weaker = publisher(node, topic, qos.SENSOR)
    problems = taken.tap.unrecorded.problems
    await until(lambda: problems)
    assert "cannot be subscribed to (RuntimeError: no descriptor is free)" in problems[topic]
    no_subscription.clear()
    await until(lambda: not problems and weaker.get_subscription_count())
    weaker.publish(number(5))
    await until(lambda: taken.values(topic) == [5])


async def test_a_second_type_of_a_topic_is_named_until_it_is_gone(
    taken: Any, node: Any, new_context: Callable[[], Any], topic: str, until: Until
) -> None:
    from rclpy.node import Node
    from std_msgs.msg import String

    publisher(node, topic)
    await until(lambda: topic in taken.topics)
    other = Node("other", context=new_context())
    second = publisher(other, topic, kind=String)
    problems = taken.tap.unrecorded.problems
    await until(lambda: problems)
    assert problems == {
        topic: f"{topic} is recorded as std_msgs/msg/UInt64, not as std_msgs/msg/String"
    }
    other.destroy_publisher(second)
    await until(lambda: not problems)
    other.destroy_node()


async def test_images_that_come_too_fast_do_not_fill_the_memory(
    taken: Any, node: Any, topic: str, until: Until
) -> None:
    from sensor_msgs.msg import Image

    images, numbers = publisher(node, topic, 1000, Image), publisher(node, topic + "_2", 1000)
    await until(lambda: images.get_subscription_count() and numbers.get_subscription_count())
    for value in range(1, 301):  # the loop takes no message meanwhile
        images.publish(Image(height=value))
        numbers.publish(number(value))
    await until(lambda: len(taken.messages[topic + "_2"]) == 300)
    await until(lambda: taken.messages[topic] and taken.messages[topic][-1][3] == 300)
    assert len(taken.messages[topic]) == qos.RECORDING_DEPTH_BULKY


# The description of a topic


def test_a_definition_holds_its_dependencies_once_in_rosbag2s_form() -> None:
    text = definition_of("nav_msgs/msg/Odometry")
    sections = text.split("=" * 80 + "\nMSG: ")
    names = [section.splitlines()[0] for section in sections[1:]]
    assert names == [
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose",
        "geometry_msgs/Point",
        "geometry_msgs/Quaternion",
        "geometry_msgs/TwistWithCovariance",
        "geometry_msgs/Twist",
        "geometry_msgs/Vector3",
    ]
    assert sections[0].rstrip().endswith("geometry_msgs/TwistWithCovariance twist")


@pytest.mark.parametrize("name", ["nope/msg/Nope", "std_msgs/msg/Nope", "std_srvs/srv/Nope", "x"])
def test_what_has_no_definition_has_none(name: str) -> None:
    assert (definition_of(name), type_hash_of(name)) == ("", "")


@pytest.mark.parametrize(
    ("name", "bulky"),
    [
        ("sensor_msgs/msg/CompressedImage", True),
        ("nav_msgs/msg/OccupancyGrid", True),
        ("stereo_msgs/msg/DisparityImage", True),
        ("nav_msgs/msg/Odometry", False),
        ("sensor_msgs/msg/LaserScan", False),
    ],
)
def test_what_holds_any_number_of_bytes_is_known_from_its_definition(
    name: str, bulky: bool
) -> None:
    assert holds_bytes(name) is bulky


def test_the_qos_is_written_as_rosbag2_writes_it() -> None:
    (profile,) = yaml.safe_load(qos.to_yaml([qos.LATCHED]))
    forever = {"sec": 9_223_372_036, "nsec": 854_775_807}
    assert profile == {
        "history": "keep_last",
        "depth": 1,
        "reliability": "reliable",
        "durability": "transient_local",
        "deadline": forever,
        "lifespan": forever,
        "liveliness": "automatic",
        "liveliness_lease_duration": forever,
        "avoid_ros_namespace_conventions": False,
    }
