"""The tap records every topic of any publisher, and names the ones that it cannot record.

A tap for viewers says why a topic cannot be subscribed to, until it can.
Each message reaches the sink once, in whatever order two subscriptions deliver.
A subscription that hears nothing of a publisher for its QoS is named while it is there.
A large message is passed to the recorder as a view, and its buffer is freed.
"""

from __future__ import annotations

import asyncio
from array import array
from random import Random
from threading import Event
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import Empty, String, UInt8MultiArray, UInt64

from robotctl.messages.installed import installed_type
from robotctl.ros import qos
from robotctl.ros.executor import RawTap, raw_tap
from robotctl.ros.executor.raw_tap import SerializedTaker
from robotctl.ros.graph.endpoints import Endpoint
from robotctl.ros.message_types import OwnTopic
from robotctl.ros.session import Session
from robotctl.ros.tap import subscription as subscription_module
from robotctl.ros.tap.on_demand import OnDemandTap
from robotctl.ros.tap.subscription import MAX_GAPS, MAX_PUBLISHERS, LatchedMerge
from robotctl.ros.tap.tap import MAX_ENDPOINTS, Tap, mismatch
from tests.ros.conftest import Taken
from tests.support.waiting import loop_until as until


def publisher(node: Any, topic: str, profile: Any = 10, kind: Any = None) -> Any:
    return node.create_publisher(kind or UInt64, topic, profile)


def number(value: int) -> Any:
    return UInt64(data=value)


async def test_a_foreign_topic_is_taken_with_all_that_describes_it(
    taken: Any, node: Any, topic: str
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


async def test_our_own_topic_is_taken_from_its_first_message(session: Session, topic: str) -> None:
    taken = Taken()
    Tap(session, taken.open).subscribe_own(OwnTopic(topic, UInt64, qos.COMMAND))
    publisher(session.node("ours"), topic).publish(number(1))
    await until(lambda: taken.messages[topic])
    assert [message[3] for message in taken.messages[topic]] == [1]


async def test_what_nobody_publishes_and_what_comes_otherwise_are_not_subscribed_to(
    taken: Any, node: Any, topic: str
) -> None:
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
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    load = subscription_module.load_type

    def missing(type_name: str) -> str:
        return "is not installed" if type_name == "std_msgs/msg/String" else load(type_name)

    monkeypatch.setattr(subscription_module, "load_type", missing)
    problems = taken.tap.unrecorded.by_topic
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


async def test_a_topic_that_cannot_be_followed_for_a_while_is_named_until_it_can(
    taken: Any, node: Any, topic: str, no_subscription: Event
) -> None:
    reliable = publisher(node, topic)
    await until(reliable.get_subscription_count)
    no_subscription.set()
    weaker = publisher(node, topic, qos.SENSOR)
    problems = taken.tap.unrecorded.by_topic
    await until(lambda: problems)
    assert "cannot be subscribed to (RuntimeError: no descriptor is free)" in problems[topic]
    no_subscription.clear()
    await until(lambda: not problems and weaker.get_subscription_count())
    weaker.publish(number(5))
    await until(lambda: taken.values(topic) == [5])


async def test_images_that_come_too_fast_do_not_fill_the_memory(
    taken: Any, node: Any, topic: str
) -> None:
    images, numbers = publisher(node, topic, 1000, Image), publisher(node, topic + "_2", 1000)
    await until(lambda: images.get_subscription_count() and numbers.get_subscription_count())
    for value in range(1, 301):  # the loop takes no message meanwhile
        images.publish(Image(height=value))
        numbers.publish(number(value))
    await until(lambda: len(taken.messages[topic + "_2"]) == 300)
    await until(lambda: taken.messages[topic] and taken.messages[topic][-1][3] == 300)
    assert len(taken.messages[topic]) == qos.RECORDING_DEPTH_BULKY


# The description of a topic


def test_what_holds_any_number_of_bytes_is_known_from_its_definition() -> None:
    for name in ("sensor_msgs/msg/CompressedImage", "stereo_msgs/msg/DisparityImage"):
        assert installed_type(name).holds_bytes
    for name in ("nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"):
        assert not installed_type(name).holds_bytes


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


class Watcher:
    """What a tap has told."""

    def __init__(self) -> None:
        self.topics: set[str] = set()
        self.problems: dict[str, str] = {}

    def appeared(self, topic: str, *_: str) -> None:
        self.topics.add(topic)

    def vanished(self, topic: str) -> None:
        self.topics.discard(topic)

    def unusable(self, topic: str, problem: str) -> None:
        self.problems[topic] = problem


async def test_a_problem_is_taken_back_once_the_topic_can_be_subscribed_to(
    session: Any, node: Any, topic: str, no_subscription: Event
) -> None:
    no_subscription.set()
    published, watcher = node.create_publisher(UInt64, topic, 10), Watcher()
    tap = OnDemandTap(session.node("_view"), watcher)
    watching = asyncio.create_task(tap.run())
    try:
        await until(lambda: topic in watcher.topics)
        heard: list[bytes] = []
        tap.want(topic, lambda data, *_: heard.append(bytes(data)))
        assert (
            "cannot be subscribed to (RuntimeError: no descriptor is free)"
            in watcher.problems[topic]
        )
        no_subscription.clear()
        await until(published.get_subscription_count)
        assert watcher.problems[topic] == ""
        published.publish(UInt64(data=5))
        await until(lambda: heard)
    finally:
        watching.cancel()
        await asyncio.wait({watching})
        tap.unwant(topic)


class Got:
    """A merge and the numbers that reached its sink."""

    def __init__(self) -> None:
        self.got: list[tuple[bytes, int]] = []
        self.merge = LatchedMerge(
            lambda data, received_ns, source_ns, sequence, gid: self.got.append((gid, sequence))
        )

    def get(self, sequence: int, gid: bytes = b"one") -> None:
        self.merge(b"", 0, 0, sequence, gid)

    @property
    def sequences(self) -> list[int]:
        return sorted(sequence for _, sequence in self.got)


@given(st.sets(st.integers(1, 20)), st.sets(st.integers(1, 20)), st.integers())
def test_what_one_subscription_lost_and_the_other_got_is_handed_on_once(
    live: set[int], latched: set[int], seed: int
) -> None:
    dice, merged = Random(seed), Got()
    queues = [sorted(live), sorted(latched)]
    while queue := dice.choice([each for each in queues if each] or [[]]):
        merged.get(queue.pop(0))
    assert merged.sequences == sorted(live | latched)


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.integers(0, 4)), max_size=8))
def test_what_is_latched_is_handed_on_once_however_often_it_is_subscribed_to(
    phases: list[tuple[bool, int, int]],
) -> None:
    merged, sent = Got(), 1
    for mixed, depth, more in phases:
        for sequence in range(max(1, sent - depth), sent + 1):
            merged.get(sequence)
        for _ in range(more):
            sent += 1
            if mixed:
                merged.get(sent)
            merged.get(sent)
    assert merged.sequences == (list(range(1, sent + 1)) if phases else [])


def test_what_a_publisher_repeats_that_was_lost_and_found_is_handed_on_once() -> None:
    merged = Got()
    for sequence in (1, 2, 3, 2, 3, 4):  # the same subscription: this process did not notice
        merged.get(sequence)
    assert merged.sequences == [1, 2, 3, 4]


def test_a_publisher_that_does_not_count_is_heard() -> None:
    merged = Got()
    merged.get(0)
    merged.get(0)
    assert merged.sequences == [0, 0]


def test_publishers_are_told_apart() -> None:
    merged = Got()
    merged.get(1, b"latching")
    merged.get(1, b"other")
    merged.get(1, b"latching")
    assert merged.got == [(b"latching", 1), (b"other", 1)]


def test_publishers_that_keep_restarting_take_no_more_than_so_much_memory() -> None:
    merged = Got()
    for number in range(2 * MAX_PUBLISHERS):
        merged.get(1, number.to_bytes(16, "big"))
    assert len(merged.got) == 2 * MAX_PUBLISHERS
    for odd in range(3, 1_000, 2):
        merged.get(odd, (1).to_bytes(16, "big"))
    known = merged.merge._delivered
    assert (len(known), len(known[(1).to_bytes(16, "big")].gaps)) == (MAX_PUBLISHERS, MAX_GAPS)


RELIABLE = QoSProfile(depth=1)
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def end(node: str, qos: QoSProfile) -> Endpoint:
    return Endpoint(node, "/", "std_msgs/msg/String", node.encode(), qos)


@pytest.mark.parametrize(
    ("offered", "asked", "reason"),
    [
        (BEST_EFFORT, RELIABLE, "reliability best_effort is offered, reliable asked for"),
        (RELIABLE, LATCHED, "durability volatile is offered, transient_local asked for"),
        (RELIABLE, BEST_EFFORT, ""),
        (LATCHED, RELIABLE, ""),
        (RELIABLE, RELIABLE, ""),
        (LATCHED, LATCHED, ""),
    ],
)
def test_what_is_asked_for_and_not_offered_is_named(
    offered: QoSProfile, asked: QoSProfile, reason: str
) -> None:
    told = mismatch("/scan", [end("lidar", offered)], [end("slam", asked)])
    assert told == (reason and f"/slam hears nothing of /lidar on /scan: {reason}")


def test_the_recorder_itself_is_no_mismatch() -> None:
    assert mismatch("/map", [end("map", RELIABLE)], [end("_recorder", LATCHED)]) == ""


def test_names_of_others_stay_on_their_line() -> None:
    told = mismatch("/a", [end("b\n\x1b[2J", BEST_EFFORT)], [end("c", RELIABLE)])
    assert told.isprintable()


def test_a_thousand_endpoints_cost_no_million_pairs() -> None:
    many = [end(f"n{number}", BEST_EFFORT) for number in range(1000)]
    last = end("last", RELIABLE)
    assert mismatch("/a", many, [*many[: MAX_ENDPOINTS - 1], last]) != ""
    assert mismatch("/a", many, [*many, last]) == ""


async def test_a_mismatch_is_named_as_long_as_both_are_there(
    taken: Any, node: Any, topic: str, caplog: pytest.LogCaptureFixture
) -> None:
    said = taken.tap.mismatches.warnings
    node.create_publisher(Empty, topic, BEST_EFFORT)
    await until(lambda: topic in taken.topics)
    assert list(said()) == []
    for begun in (1, 2):
        deaf = node.create_subscription(Empty, topic, print, RELIABLE)
        await until(lambda: list(said()))
        (told,) = said()
        assert told.endswith(f" on {topic}: reliability best_effort is offered, reliable asked for")
        assert caplog.messages.count(told) == begun
        node.destroy_subscription(deaf)
        await until(lambda: not list(said()))


LARGE = raw_tap.LARGE_BYTES + 1


def large(value: int) -> Any:
    return UInt8MultiArray(data=array("B", bytes([value]) * LARGE))


@pytest.mark.parametrize("views", [True, False])
async def test_a_large_message_is_whole_and_only_lent_where_that_is_asked_for(
    executor: Any, node: Any, topic: str, views: bool
) -> None:
    taken: list[bytes | memoryview] = []
    copies: list[bytes] = []

    def sink(data: Any, *_: Any) -> None:
        taken.append(data)
        copies.append(bytes(data))

    node.create_subscription(UInt8MultiArray, topic, RawTap(sink, views=views), 10, raw=True)
    publisher = node.create_publisher(UInt8MultiArray, topic, 10)
    await until(publisher.get_subscription_count)
    for value in (1, 2):
        publisher.publish(large(value))
    await until(lambda: len(taken) == 2)
    assert [copy[-LARGE:] == bytes([value]) * LARGE for value, copy in enumerate(copies, 1)] == [
        True,
        True,
    ]
    if views:
        with pytest.raises(ValueError, match="released"):
            len(taken[0])
    else:
        assert taken == copies


async def test_a_buffer_that_does_not_fit_the_budget_is_given_back_at_once(
    executor: Any, node: Any, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raw_tap, "KEPT_BYTES", SerializedTaker._kept_by_all + LARGE * 2)
    topics = [f"{topic}_{number}" for number in range(4)]
    heard: list[int] = []
    taps = [RawTap(lambda data, *_: heard.append(len(data))) for _ in topics]
    kept_before = SerializedTaker._kept_by_all
    subscriptions = [
        node.create_subscription(UInt8MultiArray, name, tap, 10, raw=True)
        for name, tap in zip(topics, taps, strict=True)
    ]
    publishers = [node.create_publisher(UInt8MultiArray, name, 10) for name in topics]
    await until(lambda: all(each.get_subscription_count() for each in publishers))
    for publisher in publishers:
        publisher.publish(large(0))
    await until(lambda: len(heard) == len(topics))
    await until(lambda: SerializedTaker._kept_by_all > kept_before)  # at the take after a message
    assert SerializedTaker._kept_by_all <= raw_tap.KEPT_BYTES
    for subscription in subscriptions:
        node.destroy_subscription(subscription)
    await until(lambda: SerializedTaker._kept_by_all == kept_before)
