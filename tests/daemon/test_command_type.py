"""A base that takes TwistStamped is driven with it, and recorded, and checked."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message

from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, Peer, World, read_back

STAMPED = "geometry_msgs/msg/TwistStamped"


def test_a_base_that_takes_twist_stamped_is_driven_recorded_and_checked(world: World) -> None:
    settings = world.folder / "base.yaml"
    settings.write_text(f"{PATIENT}command: {{stamped: true, frame_id: base}}\n")
    base = world.spawn("sim", "--config", str(settings))
    assert base.stdout is not None
    base.stdout.readline()
    settings.write_text(f"{PATIENT}command.frame_id: base\n")
    world.ok("start", "--no-sim", "--config", str(settings))
    until(
        lambda: (
            world.here("drive", "square", "--side", "0.2", "--laps", "1", "--wait").exit_code == 0
        )
    )
    world.ok("stop")
    base.terminate()
    base.communicate(timeout=DEADLINE_S)
    assert "same" in world.ok("replay", "--check", "last")
    messages = read_back(next(world.recordings.iterdir()))["/cmd_vel"]
    commands = [deserialize_message(each.data, TwistStamped) for each in messages]
    assert {each.header.frame_id for each in commands} == {"base"}
    assert max(each.twist.linear.x for each in commands) > 0.1
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in commands]
    late_ns = [each.log_time - stamp for each, stamp in zip(messages, stamps, strict=True)]
    assert min(late_ns) >= 0
    assert sorted(stamps) == stamps


def test_two_nodes_that_want_different_types_are_both_named(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    peer = new_peer(world)
    peer("take_commands", kind="TwistStamped")
    world.ok("start", "--sim")
    until(lambda: any(STAMPED in each for each in world.status()["warnings"]))
    refused = world.robotctl("drive", "square")
    assert refused.exit_code == 4
    assert "some nodes take geometry_msgs/msg/Twist on cmd_vel, others" in refused.err
    assert "set command.stamped to true" in refused.err
    world.ok("stop")


def test_a_robot_that_wants_another_type_of_command_is_not_driven_blind(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    peer, another = new_peer(world), new_peer(world)
    peer("take_commands", kind="TwistStamped")
    peer("measure", x=0.0)
    settings = world.folder / "twist.yaml"
    settings.write_text('battery.topic: ""\ncommand.stamped: false\n')
    world.ok("start", "--no-sim", "--config", str(settings))
    wanted = "the robot takes geometry_msgs/msg/TwistStamped on cmd_vel"
    until(lambda: any(wanted in each for each in world.status()["warnings"]))
    refused = world.here("drive", "square")
    assert refused.exit_code == 4
    assert wanted in refused.err
    assert "if it runs, start robotctl again" in refused.err
    another("take_commands", kind="Twist")
    until(lambda: world.here("set-mode", "moving").exit_code == 0)
    world.ok("stop")


@pytest.mark.slow
def test_a_base_that_starts_after_robotctl_is_driven_as_its_refusal_says(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    peer = new_peer(world)
    peer("measure", x=0.0)
    settings = world.folder / "late.yaml"
    settings.write_text(f'{PATIENT}battery.topic: ""\n')
    start = ("start", "--no-sim", "--config", str(settings))
    world.ok(*start)
    peer("take_commands", kind="TwistStamped")
    until(lambda: any(STAMPED in each for each in world.status()["warnings"]))
    refused = world.here("set-mode", "moving")
    assert refused.exit_code == 4
    assert "if it runs, start robotctl again" in refused.err
    world.ok("stop")
    world.ok(*start)
    until(lambda: world.here("set-mode", "moving").exit_code == 0)
    world.ok("stop")
