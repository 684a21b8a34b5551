"""Who publishes a message is named, also before its publisher is announced."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String

from robotctl.ros.graph.endpoints import PROCESS_BYTES, gid_of, node_of

TOPIC = "/told"


@pytest.fixture
def context(domain_id: int) -> Iterator[Context]:
    made = Context()
    made.init(args=[], domain_id=domain_id)
    yield made
    made.try_shutdown()
    made.destroy()


def test_a_publisher_that_is_not_announced_yet_has_the_name_of_the_only_node_of_its_process(
    context: Context,
) -> None:
    planner = Node("planner", namespace="/front", context=context)
    gid = gid_of(planner.create_publisher(String, TOPIC, 1))
    later, stranger = gid[:PROCESS_BYTES] + b"\xee\xee\xee\x03", bytes(16)
    assert node_of(planner, TOPIC, gid) == "/front/planner"
    assert node_of(planner, TOPIC, later) == "/front/planner"
    assert node_of(planner, TOPIC, stranger) == ""

    other = Node("other", context=context)
    assert node_of(planner, TOPIC, gid) == "/front/planner"
    assert node_of(planner, TOPIC, later) == ""
    other.destroy_node()
    planner.destroy_node()
