"""`robotctl doctor` beside real ROS processes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from tests.support.first_package import MISTAKES, healthy
from tests.support.world import Peer, World


def test_a_daemon_and_its_robot_are_healthy_and_a_base_of_another_type_is_named(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim")
    found = world.answer_here("doctor")["findings"]
    assert [each for each in found if each["level"] == "fault"] == []
    told = {each["check"]: each["text"] for each in found}
    assert told["odometry"].startswith("/odom (nav_msgs/msg/Odometry): 1 publishers")
    new_peer(world)("take_commands", kind="TwistStamped")
    ran = world.here("doctor", "--json")
    answer = json.loads(ran.out)
    faults = [each for each in answer["findings"] if each["level"] == "fault"]
    assert ran.exit_code == 4
    assert ["several types" in each["text"] and each["check"] for each in faults] == ["command"]
    assert answer["error"]["cure"] == faults[0]["cure"]
    world.ok("stop")


def test_a_package_is_judged_without_a_daemon(world: World, tmp_path: Path) -> None:
    package = healthy(tmp_path)
    assert world.here("doctor", str(package)).exit_code == 0
    MISTAKES["rclpy from pip"][1](package)
    ran = world.here("doctor", str(package))
    assert ran.exit_code == 4
    assert "fault    two rclpys  setup.py lets pip bring rclpy" in ran.out
    assert "cure: leave it out" in ran.out
    assert world.here("doctor", str(tmp_path / "nowhere")).exit_code == 2
