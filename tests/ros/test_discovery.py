"""A wait for discovery ends when all processes of the domain are completely discovered."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String

from robotctl.ros.graph.discovery import Discovery, _count_complete
from robotctl.ros.playback.membership import Membership

TOPICS = [f"/topic_{number}" for number in range(20)]
OURS, THEIRS = bytes(12), bytes([1] * 12)
WRITER, READER = b"\0\0\4\3", b"\0\0\5\4"
DISCOVERY = "ros_discovery_info"
UNNAMED = "_NODE_NAME_UNKNOWN_"


@pytest.fixture
def others(domain_id: int) -> Iterator[None]:
    """A node with many subscribers."""
    context = Context()
    context.init(args=[], domain_id=domain_id)
    node = Node("others", context=context)
    for topic in TOPICS:
        node.create_subscription(String, topic, print, 10)
    yield
    node.destroy_node()
    context.try_shutdown()
    context.destroy()


def test_everybody_is_known_in_full_when_the_wait_ends(domain_id: int, others: None) -> None:
    with Membership(domain_id) as membership:
        node = membership.node
        Discovery(node, domain_id).wait(0.3, time.monotonic() + 30.0, threading.Event())
        assert not membership.was_certainly_empty
        assert [node.count_subscribers(topic) for topic in TOPICS] == [1] * len(TOPICS)
        assert "others" in node.get_node_names()


def test_who_is_alone_on_this_machine_has_nothing_to_wait_for(
    domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Membership(domain_id) as membership:
        discovery = Discovery(membership.node, domain_id)
        assert discovery.is_alone()
        with Membership(domain_id):
            assert not discovery.is_alone()
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        assert not discovery.is_alone()


def test_where_others_may_be_on_other_machines_all_the_time_is_taken(
    domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Membership(domain_id) as membership:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        until_s = time.monotonic() + 0.5
        Discovery(membership.node, domain_id).wait(0.1, until_s, threading.Event())
        assert time.monotonic() >= until_s


def test_a_wait_that_is_stopped_ends(domain_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = threading.Event()
    stopped.set()
    with Membership(domain_id) as membership:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        Discovery(membership.node, domain_id).wait(0.1, time.monotonic() + 3600.0, stopped)


def test_whoever_has_not_said_whose_all_its_endpoints_are_has_not_been_count_complete() -> None:
    we = {(DISCOVERY, UNNAMED, OURS + WRITER), ("rt/rosout", "we", OURS + WRITER)}
    greeted = we | {(DISCOVERY, UNNAMED, THEIRS + WRITER)}
    half_known = greeted | {("rt/odom", UNNAMED, THEIRS + READER)}
    named = greeted | {("rt/odom", "they", THEIRS + READER)}
    in_part = named | {("rt/scan", UNNAMED, THEIRS + WRITER)}
    heard = [
        _count_complete(frozenset(known)) for known in (we, greeted, half_known, named, in_part)
    ]
    assert heard == [1, 1, 1, 2, 1]
