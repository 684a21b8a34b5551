"""A recording that is played and recorded again is the same."""

from __future__ import annotations

from typing import Any

from tests.support.bags import padded
from tests.support.waiting import until
from tests.support.world import World, read_back

RELIABLE = ("/cmd_vel", "/robot_status", "/robotctl/journal")
BEST_EFFORT = ("/odom", "/battery_state")


def test_a_replay_recorded_again_has_the_same_messages_in_the_same_order(world: World) -> None:
    world.ok("start", "--sim")
    until(lambda: _count(world, "/odom") > 20)
    world.ok("set-mode", "moving")
    until(lambda: _count(world, "/cmd_vel") > 150)
    world.ok("stop")
    (first,) = world.recordings.iterdir()
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
