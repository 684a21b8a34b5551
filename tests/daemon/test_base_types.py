"""A base is driven with the topics, types, rates and QoS that it wants, and recorded."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message

from robotctl.profiles import Profile
from tests.support.waiting import until
from tests.support.world import PATIENT, NewPeer, World, read_back


def test_a_robot_that_wants_another_type_of_command_is_not_driven_blind(
    world: World, new_peer: NewPeer
) -> None:
    peer, another = new_peer(world), new_peer(world)
    peer("take_commands", kind="TwistStamped")
    peer("measure", x=0.0)
    settings = 'battery.topic: ""\ncommand.stamped: false\n'
    start = world.spawn("start", "--no-sim", settings=settings)  # waits for a base
    until(lambda: world.here("status").exit_code == 0)
    wanted = "the robot takes geometry_msgs/msg/TwistStamped on cmd_vel"
    until(lambda: any(wanted in each for each in world.status()["warnings"]))
    world.here("drive", "square").failed(4, wanted, "if it runs, start robotctl again")
    another("take_commands", kind="Twist")
    start.communicate()
    until(lambda: world.here("set-mode", "moving").exit_code == 0)
    world.ok("stop")


BASES: dict[Profile, dict[str, Any]] = {
    Profile.TURTLEBOT3: {
        "command": ["cmd_vel", "TwistStamped", "system"],
        "odometry": ["odom", "system", 20],
        "battery": ["battery_state", "system", 20, 87.5],
        "child_frame": "base_footprint",
    },
    Profile.TURTLEBOT4: {
        "command": ["cmd_vel", "Twist", "sensor"],
        "odometry": ["odom", "sensor", 20],
        "battery": ["battery_state", "sensor", 0.1, 0.9],
        "child_frame": "base_link",
    },
    Profile.HUSKY: {
        "command": ["cmd_vel", "TwistStamped", "system"],
        "odometry": ["platform/odom", "system", 50],
        "battery": ["platform/bms/state", "sensor", 1, 0.9],
        "child_frame": "base_link",
    },
    Profile.DIFF_DRIVE: {
        "command": ["diff_drive_controller/cmd_vel", "TwistStamped", "system"],
        "odometry": ["diff_drive_controller/odom", "system", 50],
        "battery": None,
        "child_frame": "base_link",
    },
}
OTHERS = [
    pytest.param(each, marks=pytest.mark.slow) for each in Profile if each is not Profile.HUSKY
]


@pytest.mark.parametrize("profile", [Profile.HUSKY, *OTHERS])
def test_a_profile_drives_a_base_like_its_robot(world: World, profile: Profile) -> None:
    with world.peer("StubBase") as base:
        base("begin", **BASES[profile])
        patient = yaml.safe_load(PATIENT)  # its time limits hold for an idle machine only
        settings = yaml.safe_dump(yaml.safe_load(profile.path.read_text()) | patient)
        world.ok("start", "--no-sim", settings=settings)
        until(lambda: world.robotctl("set-mode", "moving").exit_code == 0)
        until(lambda: base("driven")["x"] > 0.1)
        frames = base("driven")["frames"]
        is_stamped = BASES[profile]["command"][1] == "TwistStamped"
        assert frames == ([BASES[profile]["child_frame"]] if is_stamped else [])
        world.ok("set-mode", "idle")
        world.ok("stop")
        assert "same" in world.ok("replay", "--check", "last")
        messages = read_back(world.recording)[f"/{BASES[profile]['command'][0]}"]
    if is_stamped:
        commands = [deserialize_message(each.data, TwistStamped) for each in messages]
        assert {each.header.frame_id for each in commands} == {BASES[profile]["child_frame"]}
        stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in commands]
        assert sorted(stamps) == stamps
        assert min(each.log_time - stamp for each, stamp in zip(messages, stamps, strict=True)) >= 0
