"""Each profile drives a stub base with the topics, types, rates and QoS of its robot."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from robotctl.profiles import Profile
from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import PATIENT, World

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
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "profile",
    [
        Profile.HUSKY,
        *(pytest.param(each, marks=SLOW) for each in Profile if each is not Profile.HUSKY),
    ],
)
def test_a_profile_drives_a_base_like_its_robot(world: World, profile: Profile) -> None:
    base = Told(peer_command("tests.support.role_peers", "StubBase"), world.environment)
    try:
        base("begin", **BASES[profile])
        settings = world.folder / "robot.yaml"
        patient = yaml.safe_load(PATIENT)  # its time limits hold for an idle machine only
        settings.write_text(yaml.safe_dump(yaml.safe_load(profile.path.read_text()) | patient))
        world.ok("start", "--no-sim", "--config", str(settings))
        until(lambda: world.robotctl("set-mode", "moving").exit_code == 0)
        until(lambda: base("driven")["x"] > 0.1)
        frames = base("driven")["frames"]
        is_stamped = BASES[profile]["command"][1] == "TwistStamped"
        assert frames == ([BASES[profile]["child_frame"]] if is_stamped else [])
        world.ok("set-mode", "idle")
        world.ok("stop")
        assert "same" in world.ok("replay", "--check", "last")
    finally:
        base.close()
