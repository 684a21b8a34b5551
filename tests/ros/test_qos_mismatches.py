"""A subscription that hears nothing of a publisher for its QoS is named while it is there."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.ros.graph.endpoints import Endpoint
from robotctl.ros.tap.tap import MAX_ENDPOINTS, mismatch

Until = Callable[[Callable[[], object]], Awaitable[None]]

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
    taken: Any, node: Any, topic: str, until: Until
) -> None:
    from std_msgs.msg import Empty

    said = taken.tap.mismatches.warnings
    node.create_publisher(Empty, topic, BEST_EFFORT)
    await until(lambda: topic in taken.topics)
    assert list(said()) == []
    deaf = node.create_subscription(Empty, topic, print, RELIABLE)
    await until(lambda: list(said()))
    (told,) = said()
    assert told.endswith(f" on {topic}: reliability best_effort is offered, reliable asked for")
    node.destroy_subscription(deaf)
    await until(lambda: not list(said()))
