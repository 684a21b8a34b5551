"""Nodes that publish commands or odometry, or subscribe to another type of command."""

from __future__ import annotations

import json
import re
from collections.abc import Callable

from tests.support.waiting import until
from tests.support.world import Peer, World, journal_of, read_back

Event = dict[str, float]


def events(world: World, name: str) -> list[Event]:
    """Return the journal entries of the closed recording with this name."""
    entries = journal_of(read_back(next(world.recordings.iterdir()))["/robotctl/journal"])
    return [json.loads(entry.data) | {"seq": entry.seq} for entry in entries if entry.name == name]


def test_one_command_of_a_publisher_that_is_gone_at_once_stops_a_moving_robot(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    peer = new_peer(world)
    sent_ns = peer("command_and_go", linear=0.1)
    until(lambda: world.status()["mode"] == "ERROR")
    # The graph may show the publisher before its command comes.
    assert re.search("also publishe[sd] (a )?velocity command", world.status()["mode_reason"])
    world.ok("stop")
    (heard, *_) = events(world, "ForeignCommandHeard")
    assert heard["t_ns"] - sent_ns < 200_000_000  # 20 ms on a quiet machine


def test_commands_of_best_effort_are_heard_as_well(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    new_peer(world)("command_best_effort", linear=0.1)
    until(lambda: world.status()["mode"] == "ERROR")
    assert "velocity command" in world.status()["mode_reason"]
    world.ok("stop")
    assert events(world, "ForeignCommandHeard")


def test_one_command_to_an_idle_robot_is_named_and_no_error(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim")
    new_peer(world)("command_and_go", linear=0.1)
    until(lambda: any("velocity command" in each for each in world.status()["warnings"]))
    assert world.status()["mode"] == "IDLE"
    world.ok("stop")
    assert events(world, "ForeignCommandHeard")


def test_a_second_publisher_of_odometry_refuses_every_start(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim")
    peer = new_peer(world)
    peer("measure", x=10.0)
    until(lambda: any("and /somebody_else" in each for each in world.status()["warnings"]))
    assert world.status()["mode"] == "IDLE"
    for request in (("drive", "square", "--wait"), ("set-mode", "moving")):
        refused = world.robotctl(*request)
        assert refused.exit_code == 4
        assert "odometry comes from two publishers, /simulated_robot and /somebody_else" in (
            refused.err
        )
    assert world.status()["odometry_dropped"] > 0
    peer.close()
    until(lambda: world.robotctl("set-mode", "moving").exit_code == 0)
    world.ok("stop")
    sources = events(world, "OdometrySourceFound")
    assert {each["source"] for each in sources} == {1, 2}


def test_a_second_publisher_of_odometry_that_contradicts_stops_a_moving_robot(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim", "--drive", "circle")
    new_peer(world)("measure", x=10.0)
    until(lambda: world.status()["mode"] == "ERROR")
    reason = world.status()["mode_reason"]
    assert "odometry comes from two publishers, /simulated_robot and " in reason
    assert "m and " in reason
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
    refused = world.robotctl("drive", "square")
    assert refused.exit_code == 4
    assert wanted in refused.err
    another("take_commands", kind="Twist")
    until(lambda: world.robotctl("set-mode", "moving").exit_code == 0)
    world.ok("stop")
