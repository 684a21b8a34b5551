"""The action `drive_pattern`, with a client of plain rclpy in another process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from math import isnan
from typing import Any

import pytest

from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import World, journal_of, new_world, read_back

ENDLESS = 100_000


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with a daemon; its recording is checked at the end."""
    with new_world() as made:
        made.ok("start", "--sim")
        yield made
        made.ok("stop")
        (folder,) = made.recordings.iterdir()
        topics = read_back(folder)
        requests = [
            entry.data
            for entry in journal_of(topics["/robotctl/journal"])
            if entry.name == "DriveRequested"
        ]
        assert requests
        assert all("the ROS action /drive_pattern" in request for request in requests)
        assert topics["/drive_pattern/_action/feedback"]
        assert topics["/drive_pattern/_action/status"]


@pytest.fixture(scope="module")
def peer(world: World) -> Iterator[Told]:
    """The client's process."""
    with closing(
        Told(peer_command("tests.support.role_peers", "ActionPeer"), world.environment)
    ) as made:
        yield made


@pytest.fixture
def endless(world: World, peer: Told) -> Iterator[int]:
    """A goal that has begun to move the robot, which is IDLE again at the end."""
    number = peer("send", laps=ENDLESS)
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    yield number
    if world.status()["mode"] != "IDLE":
        world.ok("reset")


def test_a_goal_drives_its_laps_and_tells_how_well(peer: Told) -> None:
    number = peer("send", pattern="circle", size=0.15, laps=2, speed=0.3)
    result = peer("result", number=number)
    assert (result["status"], result["completed"], result["laps"]) == ("SUCCEEDED", True, 2)
    assert result["reason"] == "drive finished: 2 laps"
    assert 1.5 < result["distance"] < 2.5
    assert 0.0 < result["cross_track_rms"] <= result["cross_track_max"] < 0.15
    assert 0.0 <= result["closure"] < 0.15
    heard = peer("heard", number=number)
    distances = [distance for distance, _, _ in heard]
    assert distances == sorted(distances)
    assert {lap for _, lap, _ in heard} <= {1, 2}
    assert heard


def test_a_cancelled_goal_ramps_down(world: World, peer: Told, endless: int) -> None:
    assert peer("cancel", number=endless) == 1
    result = peer("result", number=endless)
    assert (result["status"], result["completed"]) == ("CANCELED", False)
    assert result["reason"] == "requested by the ROS action /drive_pattern, which was cancelled"
    assert isnan(result["closure"])
    assert world.status()["mode"] == "IDLE"


def test_a_second_goal_is_refused_unless_it_replaces_the_first(
    world: World, peer: Told, endless: int
) -> None:
    refused = peer("result", number=peer("send", laps=1))
    assert refused["status"] == "ABORTED"
    assert refused["reason"].startswith("the robot is MOVING: stop it first")
    second = peer("send", laps=ENDLESS, replace=True)
    replaced = peer("result", number=endless)
    assert replaced["status"] == "ABORTED"
    assert replaced["reason"] == "replaced by another drive"
    assert world.status()["mode"] == "MOVING"
    assert peer("cancel", number=second) == 1
    assert peer("result", number=second)["status"] == "CANCELED"


def test_an_emergency_stop_ends_the_goal_and_refuses_the_next(
    world: World, peer: Told, endless: int
) -> None:
    world.ok("estop")
    result = peer("result", number=endless)
    assert result["status"] == "ABORTED"
    assert result["reason"].startswith("requested by robotctl estop")
    refused = peer("result", number=peer("send", laps=1))
    assert refused["status"] == "ABORTED"
    assert refused["reason"].startswith("moving is refused in EMERGENCY_STOP")
    assert refused["reason"].endswith("release it: robotctl reset")
    assert world.status()["mode"] == "EMERGENCY_STOP"


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        ({"laps": 0}, "0 laps: a goal ends by itself: use 1 to 100000"),
        ({"laps": 4_000_000_000}, "4000000000 laps: use 0 (until stopped) to 100000"),
        ({"size": "nan"}, "a size of nan m: use 0.1 to 100 m"),
        ({"size": -1.0}, "a size of -1 m: use 0.1 to 100 m"),
        ({"speed": "inf"}, "a speed of inf m/s is above limits.linear_mps, 0.6 m/s: use at most"),
        ({"speed": "nan"}, "a speed of nan m/s: use 0.01 to 10 m/s"),
        ({"pattern": "pen\ntagon"}, "no pattern 'pen\\ntagon': use square, circle, figure-eight"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_a_goal_that_cannot_be_driven_is_aborted_with_the_reason(
    world: World, peer: Told, goal: dict[str, Any], reason: str
) -> None:
    result = peer("result", number=peer("send", **goal))
    assert (result["status"], result["completed"], result["laps"]) == ("ABORTED", False, 0)
    assert result["reason"].startswith(reason)
    assert isnan(result["cross_track_rms"])
    assert world.status()["mode"] == "IDLE"


def test_each_goal_of_a_flood_is_answered_and_a_stop_is_obeyed_meanwhile(
    world: World, peer: Told
) -> None:
    peer("begin_flood", count=500)
    world.ok("estop")
    answered = peer("end_flood")
    assert answered["answered"] == 500
    assert answered["accepted"] < 500, "their status is published at each change of each of them"
    assert world.status()["mode"] == "EMERGENCY_STOP"
    world.ok("reset")
