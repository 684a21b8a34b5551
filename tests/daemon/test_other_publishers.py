"""Nodes that publish commands or odometry while a daemon runs."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator

import pytest

from robotctl.recording import read_messages
from tests.support.waiting import until
from tests.support.world import Peer, World, journal_of, new_world

Event = dict[str, float]
NewPeer = Callable[[World], Peer]


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with one daemon, which simulates its robot."""
    with new_world() as made:
        made.ok("start", "--sim")
        yield made
        made.ok("stop")


@pytest.fixture
def idle(world: World) -> World:
    """The world, when nothing of an earlier test keeps its robot from driving."""
    until(lambda: world.here("reset").exit_code == 0)
    until(lambda: world.here("preflight").exit_code == 0)
    return world


@pytest.fixture
def driving(idle: World) -> World:
    """The world, while its robot drives."""
    until(lambda: idle.here("drive", "circle", "--laps", "0").exit_code == 0)
    return idle


def events(world: World, name: str) -> list[Event]:
    """Return the journal entries with this name that are in the recording so far."""
    (recording,) = world.recordings.iterdir()
    entries = journal_of(list(read_messages(recording, {"/robotctl/journal"})))
    return [json.loads(entry.data) | {"seq": entry.seq} for entry in entries if entry.name == name]


def heard_since(world: World, begin_ns: int) -> bool:
    """Return whether a foreign command was heard after this time."""
    return any(each["t_ns"] >= begin_ns for each in events(world, "ForeignCommandHeard"))


def test_one_command_of_a_publisher_that_is_gone_at_once_stops_a_moving_robot(
    driving: World, new_peer: NewPeer
) -> None:
    sent_ns = new_peer(driving)("command_and_go", linear=0.1)
    until(lambda: driving.status()["mode"] == "ERROR")
    # The graph may show the publisher before its command comes.
    assert re.search("also publishe[sd] (a )?velocity command", driving.status()["mode_reason"])
    until(lambda: heard_since(driving, sent_ns))


def test_commands_of_best_effort_are_heard_as_well(driving: World, new_peer: NewPeer) -> None:
    begin_ns = time.monotonic_ns()
    new_peer(driving)("command_best_effort", linear=0.1)
    until(lambda: driving.status()["mode"] == "ERROR")
    assert "velocity command" in driving.status()["mode_reason"]
    until(lambda: heard_since(driving, begin_ns))


def test_one_command_to_an_idle_robot_is_named_and_no_error(idle: World, new_peer: NewPeer) -> None:
    sent_ns = new_peer(idle)("command_and_go", linear=0.1)
    until(lambda: heard_since(idle, sent_ns))
    until(lambda: any("velocity command" in each for each in idle.status()["warnings"]))
    assert idle.status()["mode"] == "IDLE"


def test_a_second_publisher_of_odometry_refuses_every_start(idle: World, new_peer: NewPeer) -> None:
    peer = new_peer(idle)
    peer("measure", x=10.0)
    until(lambda: any("and /somebody_else" in each for each in idle.status()["warnings"]))
    assert idle.status()["mode"] == "IDLE"
    for request in (("drive", "square", "--wait"), ("set-mode", "moving")):
        refused = idle.here(*request)
        assert refused.exit_code == 4
        assert "odometry comes from two publishers, /simulated_robot and /somebody_else" in (
            refused.err
        )
    assert idle.status()["odometry_dropped"] > 0
    peer.close()
    until(lambda: idle.here("set-mode", "moving").exit_code == 0)
    idle.ok("set-mode", "idle")
    until(lambda: {1, 2} <= {each["source"] for each in events(idle, "OdometrySourceFound")})


def test_a_second_publisher_of_odometry_that_contradicts_stops_a_moving_robot(
    driving: World, new_peer: NewPeer
) -> None:
    new_peer(driving)("measure", x=10.0)
    until(lambda: driving.status()["mode"] == "ERROR")
    reason = driving.status()["mode_reason"]
    assert "odometry comes from two publishers, /simulated_robot and " in reason
    assert "m and " in reason
