"""Every kind of field is recorded, decoded and replayed byte for byte, and a replay recorded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from robotctl.recording import read_messages
from tests.support.bags import padded
from tests.support.ros_peer import node_in
from tests.support.waiting import until
from tests.support.world import World, new_world, read_back

RELIABLE = ("/cmd_vel", "/robot_status", "/robotctl/journal")
BEST_EFFORT = ("/odom", "/battery_state")


def test_a_replay_recorded_again_has_the_same_messages_in_the_same_order(world: World) -> None:
    world.ok("start", "--sim")
    until(lambda: _count(world, "/odom") > 10)
    until(lambda: world.here("set-mode", "moving").exit_code == 0)
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    world.ok("stop")
    first = world.recording
    world.ok("start", "--observe")
    topics = (*RELIABLE, *BEST_EFFORT)
    said = world.answer(
        "replay", str(first), "--topics", ",".join(topics), "--wait-for", str(len(topics))
    )
    recorded = read_back(first)
    assert (said["prefix"], said["withheld"], said["failed"]) == ("", {}, 0)
    assert said["sent"] == sum(len(recorded[topic]) for topic in topics)
    until(lambda: all(_count(world, topic) >= len(recorded[topic]) for topic in RELIABLE))
    world.ok("stop")
    (second,) = set(world.recordings.iterdir()) - {first}
    again = read_back(second)
    for topic in RELIABLE:
        assert _bytes(again[topic]) == _bytes(recorded[topic])
    for topic in BEST_EFFORT:  # messages may be lost; then the recorder reports it
        sent = iter(_bytes(recorded[topic]))
        assert all(data in sent for data in _bytes(again[topic]))


def _count(world: World, topic: str) -> int:
    counts = {each["name"]: each["count"] for each in world.status()["topics"]}
    return int(counts.get(topic, 0))


def _bytes(messages: list[Any]) -> list[bytes]:
    """Add the padding of DDS, which data recorded at its source lacks."""
    return [padded(message.data) for message in messages]


messages = pytest.importorskip("test_msgs.msg", reason="test_msgs is not installed")
fixtures = pytest.importorskip("test_msgs.message_fixtures")

TYPES = (
    *("BasicTypes", "Constants", "Defaults", "Empty", "Strings", "WStrings", "Builtins"),
    *("Arrays", "BoundedPlainSequences", "BoundedSequences", "UnboundedSequences"),
    *("Nested", "MultiNested"),
)
"""Primitives; strings, bounded and not; arrays and sequences of them, bounded and not; nested."""

DEEP = QoSProfile(depth=1000)


def topic_of(name: str) -> str:
    return f"/field_types/{name.lower()}"


class Life:
    """The sent messages, their recording, and the messages of its replay.

    `sent` are the messages as they were serialized: once, for CDR leaves its padding undefined.
    """

    def __init__(self, world: World, node: Node) -> None:
        """Publish, record and replay every type once."""
        self.messages = {name: fixtures.get_test_msg(name) for name in TYPES}
        self.sent = {
            name: [padded(serialize_message(each)) for each in self.messages[name]]
            for name in TYPES
        }
        kinds = {name: getattr(messages, name) for name in TYPES}
        publishers = {
            name: node.create_publisher(kind, topic_of(name), DEEP) for name, kind in kinds.items()
        }
        world.ok("start", "--observe")
        until(lambda: all(each.get_subscription_count() for each in publishers.values()))
        for name, publisher in publishers.items():
            for data in self.sent[name]:
                publisher.publish(data)
        count = sum(map(len, self.sent.values()))
        until(lambda: received(world) == count)
        world.ok("stop")
        for publisher in publishers.values():
            node.destroy_publisher(publisher)
        self.folder = world.recording
        self.replayed: dict[str, list[bytes]] = {name: [] for name in TYPES}
        for name, kind in kinds.items():
            heard = self.replayed[name].append
            node.create_subscription(kind, topic_of(name), heard, DEEP, raw=True)
        topics = ",".join(map(topic_of, TYPES))
        world.ok("replay", str(self.folder), "--topics", topics, "--rate", "max")
        until(lambda: sum(map(len, self.replayed.values())) == count)


@pytest.fixture(scope="module")
def life() -> Iterator[Life]:
    with new_world() as world, node_in(world.domain_id, "field_types") as node:
        yield Life(world, node)


def received(world: World) -> int:
    topics = world.answer("record", "status")["topics"]
    return sum(each["count"] for each in topics if each["name"].startswith("/field_types/"))


@pytest.mark.parametrize("name", TYPES)
def test_it_is_recorded_and_replayed_byte_for_byte(life: Life, name: str) -> None:
    assert len(life.sent[name]) > 0
    recorded = [each.data for each in read_messages(life.folder, {topic_of(name)})]
    assert recorded == life.sent[name]
    assert life.replayed[name] == recorded


@pytest.mark.parametrize("name", TYPES)
def test_what_was_recorded_is_decoded_to_what_was_sent(life: Life, name: str) -> None:
    kind = getattr(messages, name)
    recorded = read_messages(life.folder, {topic_of(name)})
    assert [deserialize_message(each.data, kind) for each in recorded] == life.messages[name]
