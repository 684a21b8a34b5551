"""No name on the graph stops the tap, loads code, or controls a terminal."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.qos import QoSProfile
from std_msgs.msg import String, UInt64

from robotctl.ros import qos
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.discovery import _discovered
from robotctl.ros.graph.endpoints import Endpoint
from robotctl.ros.tap import subscription, tap
from robotctl.ros.tap.subscription import TypeLoader
from robotctl.ros.tap.tap import MAX_WARNINGS, Tap
from tests.support.lines import Told, peer_command
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until

Hostile = Callable[..., Awaitable[None]]

STRANGE_TYPES = (
    "lib2to3/__main__/X",
    "antigravity/x/X",
    "os.path/msg/X",
    "robot_controller/__main__/X",
    "std_msgs/msg/\xff\xfe\x1b[31m",
)
STRANGE_TOPICS = ("/my-topic", "/bad\xff\x1b[31m", "/line\nfeed", "//", "/" + "x" * 245)


@pytest.fixture
def hostile(domain_id: int) -> Iterator[Hostile]:
    """A process that does not validate what it announces."""
    told = Told(
        peer_command("tests.support.hostile_peer"), {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
    )

    async def do(what: str, **parameters: Any) -> None:
        await asyncio.to_thread(told, what, **parameters)

    yield do
    told.close()


async def test_strange_types_are_named_and_nothing_is_imported(
    taken: Any, node: Any, topic: str, hostile: Hostile
) -> None:
    before = set(sys.modules)
    for number, type_name in enumerate(STRANGE_TYPES):
        await hostile("offer", topic=f"{topic}_{number}", type_name=type_name)
    await until(lambda: len(taken.tap.unrecorded.by_topic) == len(STRANGE_TYPES))
    for number, type_name in enumerate(STRANGE_TYPES[:-1]):
        assert taken.tap.unrecorded.by_topic[f"{topic}_{number}"] == (
            f"{topic}_{number} is not recorded: it has type {type_name}, "
            "which is not the name of a ROS type"
        )
    assert all(sentence.isprintable() for sentence in taken.tap.unrecorded.warnings())
    await is_still_recorded(taken, node, f"{topic}_mine")
    imported = {name.partition(".")[0] for name in set(sys.modules) - before}
    assert not imported & {"lib2to3", "antigravity", "robot_controller"}


async def test_strange_topic_names_are_named_and_the_others_are_recorded(
    taken: Any, node: Any, topic: str, hostile: Hostile
) -> None:
    for name in STRANGE_TOPICS:
        await hostile("offer", topic=name)
    await until(lambda: len(taken.tap.unrecorded.by_topic) == len(STRANGE_TOPICS) - 1)
    for sentence in taken.tap.unrecorded.warnings():
        assert sentence.endswith(" is not recorded: ROS does not allow its name")
        assert sentence.isprintable()
    await until(lambda: STRANGE_TOPICS[-1] in taken.topics)  # it is only long
    await is_still_recorded(taken, node, topic)


async def test_a_topic_of_a_node_whose_name_is_no_text_is_recorded(
    taken: Any, node: Any, topic: str, hostile: Hostile
) -> None:
    def names() -> list[str]:
        return [each.node_name for each in endpoints.publishers(node, topic)]

    await hostile("offer", topic=topic)
    await rename(hostile, lambda: names() == ["\\xff\x1b[31m"])
    await until(lambda: topic in taken.topics)
    await is_still_recorded(taken, node, topic + "_mine")


async def test_a_replay_discovers_others_whatever_their_names_are(
    node: Any, topic: str, hostile: Hostile
) -> None:
    names = STRANGE_TOPICS[:-1]  # the last has the greatest length of a DDS name
    for name in names:
        await hostile("offer", topic=f"{topic}{name}", type_name=STRANGE_TYPES[-1])

    def found() -> dict[str, bytes]:
        return {
            name: each.gid
            for name in endpoints.topics(node, dds_names=True)
            for each in endpoints.publishers(node, name, dds_names=True)
            if each.node_name == "\\xff\x1b[31m"
        }

    expected = {f"rt{topic}{name}" for name in names if name.isascii()}
    await rename(hostile, lambda: expected <= found().keys())
    assert f"rt{topic}/bad\udcff\x1b[31m" in found()
    assert set(found().values()) <= {each.gid for each in _discovered(node)}


async def rename(hostile: Hostile, seen: Callable[[], bool]) -> None:
    """Give the node of the other process a name that is not valid text.

    The process has announced its true name as well; a late participant may receive that last.
    """
    async with asyncio.timeout(DEADLINE_S):
        while not seen():
            await hostile("rename", name="\xff\x1b[31m", namespace="/\xfe")
            await asyncio.sleep(0.05)


async def is_still_recorded(taken: Any, node: Any, topic: str) -> None:
    published = node.create_publisher(UInt64, topic, 10)
    await until(published.get_subscription_count)
    published.publish(UInt64(data=7))
    await until(lambda: topic in taken.messages and taken.values(topic) == [7])


# Loading


async def test_a_type_that_takes_long_to_load_delays_neither_the_others_nor_the_look(
    taken: Any, node: Any, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    load, stuck = subscription.load_type, {"std_msgs/msg/String"}

    def slow(type_name: str) -> str:
        while type_name in stuck:
            time.sleep(0.01)
        return load(type_name)

    monkeypatch.setattr(subscription, "load_type", slow)
    monkeypatch.setattr(subscription, "SLOW_LOAD_S", 0.1)
    node.create_publisher(String, f"{topic}_slow", 10)
    await until(lambda: f"{topic}_slow" in taken.tap.unrecorded.by_topic)
    assert (
        "is not recorded yet: its type std_msgs/msg/String is not loaded after"
        in (taken.tap.unrecorded.by_topic[f"{topic}_slow"])
    )
    await is_still_recorded(taken, node, topic)
    stuck.clear()
    await until(lambda: f"{topic}_slow" in taken.topics and not taken.tap.unrecorded.by_topic)


async def test_a_topic_that_goes_before_its_type_is_loaded_is_named_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def load_slowly(_: str) -> str:
        time.sleep(0.2)
        return ""

    monkeypatch.setattr(subscription, "load_type", load_slowly)
    looking = Tap(FakeSession(), lambda topic: print)  # type: ignore[arg-type]
    for names in (["/brief", "/short"], [], []):
        found = {name: [publisher("std_msgs/msg/String")] for name in names}
        show(monkeypatch, found)
        await looking._look()
    (warning,) = looking.unrecorded.warnings()
    assert warning.endswith("came and went before it could be recorded (and 1 other topics)")
    assert sorted(caplog.messages) == [
        f"{name} (std_msgs/msg/String) came and went before it could be recorded"
        for name in ("/brief", "/short")
    ]


async def test_a_thread_that_cannot_be_started_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    loader = TypeLoader()
    assert loader.problem("std_msgs/msg/String") == "cannot be loaded (can't start new thread)"


async def test_of_many_topics_that_are_not_recorded_the_number_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(tap, "MAX_SAID", 7)
    names = [f"/bad-{number}" for number in range(MAX_WARNINGS + 3)]
    looking = Tap(FakeSession(), lambda topic: print)  # type: ignore[arg-type]
    show(monkeypatch, {name: [publisher("std_msgs/msg/String")] for name in names})
    await looking._look()
    *named, rest = looking.unrecorded.warnings()
    assert (len(named), rest) == (MAX_WARNINGS, "3 more topics are not recorded, or not whole")
    assert len(caplog.messages) == 7


# Any graph


class FakeNode:
    """Fails as rclpy does."""

    def __init__(self) -> None:
        self.subscribed = 0

    def create_subscription(self, kind: Any, topic: str, *_: Any, **__: Any) -> Any:
        self.subscribed += 1
        if not endpoints.is_topic_name(topic) or self.subscribed % 3 == 0:
            raise RuntimeError(f"cannot subscribe to {topic!r}")
        return object()

    def destroy_subscription(self, _: Any) -> None:
        pass


class FakeSession:
    def __init__(self) -> None:
        self.made = FakeNode()

    def node(self, _: str) -> FakeNode:
        return self.made

    def helper(self) -> FakeNode:
        return self.made

    def resolve(self, topic: str) -> str:
        return topic


def publisher(type_name: str, profile: QoSProfile = qos.COMMAND) -> Endpoint:
    return Endpoint("node", "/", type_name, bytes(16), profile)


def show(monkeypatch: pytest.MonkeyPatch, snapshot: dict[str, list[Endpoint]]) -> None:
    monkeypatch.setattr(
        endpoints,
        "topics",
        lambda _: {name: [each.topic_type for each in found] for name, found in snapshot.items()},
    )
    monkeypatch.setattr(endpoints, "publishers", lambda _, topic: snapshot.get(topic, []))

    def count(_: Any, topic: str) -> int:
        assert endpoints.is_topic_name(topic), topic
        return len(snapshot.get(topic, ()))

    monkeypatch.setattr(endpoints, "publisher_count", count)


ANY = st.text(st.characters(exclude_categories=()), max_size=12)
NAMES = ANY | st.sampled_from(["/a", "/b", "/a/_b", "/my-topic", "", "/", *STRANGE_TOPICS])
TYPES = ANY | st.sampled_from(["std_msgs/msg/String", "std_msgs/msg/UInt64", *STRANGE_TYPES])
PUBLISHERS = st.builds(publisher, TYPES, st.sampled_from([qos.COMMAND, qos.LATCHED, qos.SENSOR]))
SNAPSHOTS = st.dictionaries(NAMES, st.lists(PUBLISHERS, max_size=3), max_size=6)


@settings(max_examples=50)
@given(snapshots=st.lists(SNAPSHOTS, max_size=5))
def test_no_graph_fails_the_look(snapshots: list[dict[str, list[Endpoint]]]) -> None:
    async def look() -> None:
        session = FakeSession()
        looking = Tap(session, lambda topic: print)  # type: ignore[arg-type]
        for snapshot in snapshots:
            show(patch, snapshot)
            for _ in range(tap.LOOKS_PER_INSPECTION):
                await looking._look()
                await asyncio.sleep(0)
        for sentence in looking.unrecorded.warnings():
            assert sentence.isprintable()
            sentence.encode()

    with pytest.MonkeyPatch.context() as patch:
        asyncio.run(look())
