"""What other nodes publish is watched, throttled where configured, and checked nevertheless."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from tests.support.ros_peer import node_in
from tests.support.waiting import until
from tests.support.world import PATIENT, World, new_world, read_back

SCAN_HZ, CAMERA_HZ, KEPT_HZ = 20.0, 30.0, 5.0
IN_TIME_S = 1.0
SLACK_S = 1.5
"""For a busy machine: the warning is stamped by a process that may wait."""

CONFIG = f"""{PATIENT}
recording.expected_rates: {{"/scan": {SCAN_HZ:g}}}
on_topic_trouble: refuse
recording.throttle: {{"/camera/*": {KEPT_HZ:g}, "/odom": 1}}
"""


@contextmanager
def publishing(world: World, name: str, topic: str, hz: float) -> Iterator[Node]:
    """A node of another process's kind that publishes regularly until the end of the block."""
    with node_in(world.domain_id, name) as node:
        publisher = node.create_publisher(String, topic, 10)
        node.create_timer(1.0 / hz, lambda: publisher.publish(String(data="x" * 100)))
        yield node


def warnings(world: World, what: str) -> list[str]:
    return [each for each in world.status()["warnings"] if what in each]


def topic(world: World, name: str) -> dict[str, Any]:
    found = [each for each in world.status()["topics"] if each["name"] == name]
    return found[0] if found else {"count": 0, "throttled": 0}


def test_a_sensor_that_stops_is_named_and_a_throttled_recording_is_the_same() -> None:
    with new_world() as world:
        config = world.folder / "health.yaml"
        config.write_text(CONFIG)
        with publishing(world, "camera", "/camera/image", CAMERA_HZ):
            with publishing(world, "lidar", "/scan", SCAN_HZ):
                world.ok("start", "--sim", "--config", str(config))
                until(lambda: world.here("drive", "circle").exit_code == 0)
                until(lambda: topic(world, "/camera/image")["throttled"] > 50)
                until(lambda: topic(world, "/scan")["count"] > 20)
            stopped_s = time.time()
            (told,) = until(lambda: warnings(world, "/scan has been silent"))
            world.ok("set-mode", "idle")
            refused = world.robotctl("drive", "circle")
            (screen,) = until(
                lambda: [line for line in world.ok("status").splitlines() if " throttled" in line]
            )
        camera, recorder = topic(world, "/camera/image"), world.status()["recorder"]
        with publishing(world, "lidar", "/scan", SCAN_HZ):
            (over,) = until(lambda: warnings(world, "/scan was silent"))
            until(lambda: warnings(world, "the publisher of /scan was restarted"))
        world.ok("stop")
        folder = next(world.recordings.iterdir())
        checked = world.answer("replay", "--check", str(folder))
        topics = read_back(folder)

    assert told.endswith(" s (20 messages a second are expected)")
    assert over.endswith(" s ago")
    assert (refused.exit_code, "/scan is silent" in refused.err) == (4, True)
    assert camera["count"] + camera["throttled"] > 5 * camera["count"]
    assert (camera["lost"], recorder["lost"], recorder["dropped"]) == (0, 0, 0)
    assert recorder["throttled"] >= camera["throttled"]
    assert screen.split()[-1] == "throttled"
    assert [each["verdict"] for each in checked["recordings"]] == ["same"]
    assert len(topics["/odom"]) > 100, "what a check needs is never throttled"
    for name in ("/rosout", "/diagnostics"):
        first_ns = next(
            each.log_time for each in topics[name] if b"/scan has been silent" in bytes(each.data)
        )
        assert first_ns / 1e9 - stopped_s <= IN_TIME_S + SLACK_S, name
