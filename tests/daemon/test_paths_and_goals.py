"""Paths, velocities and goals of the action, driven by the real daemon and its simulated robot."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, isnan
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording import read_messages
from tests.support.lines import Told
from tests.support.waiting import until
from tests.support.world import PATIENT, NewPeer, Peer, World, entries_of, world_with_daemon

ENDLESS = 100_000


AGILE = f"""{PATIENT}
limits: {{linear_accel_mps2: 2.0, angular_rps: 4.0, angular_accel_rps2: 10.0}}
"""
"""A small circle takes 2 s."""


@pytest.fixture(scope="module")
def simulated() -> Iterator[World]:
    with world_with_daemon(settings=AGILE) as made:
        until(lambda: made.here("preflight").exit_code == 0)
        yield made


@pytest.fixture(scope="module")
def client(simulated: World) -> Iterator[Told]:
    """The client's process."""
    with simulated.peer("ActionPeer") as made:
        yield made


@pytest.fixture
def endless(simulated: World, client: Told) -> Iterator[int]:
    """A goal that has begun to move the robot, which is IDLE again at the end."""
    number = client("send", laps=ENDLESS)
    until(lambda: simulated.status()["velocity"]["linear"] > 0.05)
    yield number
    if simulated.status()["mode"] != "IDLE":
        simulated.ok("reset")


def test_a_goal_drives_its_laps_and_tells_how_well(simulated: World, client: Told) -> None:
    number = client("send", pattern="circle", size=0.1, laps=2, speed=0.4)
    result = client("result", number=number)
    assert (result["status"], result["completed"], result["laps"]) == ("SUCCEEDED", True, 2)
    assert result["reason"] == "drive finished: 2 laps"
    assert 1.0 < result["distance"] < 1.7
    assert 0.0 < result["cross_track_rms"] <= result["cross_track_max"] < 0.15
    assert 0.0 <= result["closure"] < 0.15
    heard = client("heard", number=number)
    distances = [distance for distance, _, _ in heard]
    assert distances == sorted(distances)
    assert {lap for _, lap, _ in heard} <= {1, 2}
    assert heard
    file = Path(simulated.answer_here("record", "split")["finished"])
    (asked,) = (each.data for each in entries_of(file) if each.name == "DriveRequested")
    assert "the ROS action /drive_pattern" in asked
    for topic in ("feedback", "status"):
        assert any(read_messages(file, {f"/drive_pattern/_action/{topic}"}))


def test_a_cancelled_goal_ramps_down(simulated: World, client: Told, endless: int) -> None:
    assert client("cancel", number=endless) == 1
    result = client("result", number=endless)
    assert (result["status"], result["completed"]) == ("CANCELED", False)
    assert result["reason"] == "requested by the ROS action /drive_pattern, which was cancelled"
    assert isnan(result["closure"])
    assert simulated.status()["mode"] == "IDLE"


def test_a_second_goal_is_refused_unless_it_replaces_the_first(
    simulated: World, client: Told, endless: int
) -> None:
    refused = client("result", number=client("send", laps=1))
    assert refused["status"] == "ABORTED"
    assert refused["reason"].startswith("the robot is MOVING: stop it first")
    second = client("send", laps=ENDLESS, replace=True)
    replaced = client("result", number=endless)
    assert replaced["status"] == "ABORTED"
    assert replaced["reason"] == "replaced by another drive"
    assert simulated.status()["mode"] == "MOVING"
    assert client("cancel", number=second) == 1
    assert client("result", number=second)["status"] == "CANCELED"


def test_an_emergency_stop_ends_the_goal_and_refuses_the_next(
    simulated: World, client: Told, endless: int
) -> None:
    simulated.ok("estop")
    result = client("result", number=endless)
    assert result["status"] == "ABORTED"
    assert result["reason"].startswith("requested by robotctl estop")
    refused = client("result", number=client("send", laps=1))
    assert refused["status"] == "ABORTED"
    assert refused["reason"].startswith("moving is refused in EMERGENCY_STOP")
    assert refused["reason"].endswith("release it: robotctl reset")
    assert simulated.status()["mode"] == "EMERGENCY_STOP"


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
    simulated: World, client: Told, goal: dict[str, Any], reason: str
) -> None:
    result = client("result", number=client("send", **goal))
    assert (result["status"], result["completed"], result["laps"]) == ("ABORTED", False, 0)
    assert result["reason"].startswith(reason)
    assert isnan(result["cross_track_rms"])
    assert simulated.status()["mode"] == "IDLE"


def test_each_goal_of_a_flood_is_answered_and_a_stop_is_obeyed_meanwhile(
    simulated: World, client: Told
) -> None:
    client("begin_flood", count=500)
    simulated.ok("estop")
    answered = client("end_flood")
    assert answered["answered"] == 500
    assert answered["accepted"] < 500, "their status is published at each change of each of them"
    assert simulated.status()["mode"] == "EMERGENCY_STOP"
    simulated.ok("reset")


def place(world: World) -> tuple[float, float]:
    pose: Any = world.status()["pose"]
    return pose["x"], pose["y"]


def distance(begin: tuple[float, float], end: tuple[float, float]) -> float:
    return hypot(end[0] - begin[0], end[1] - begin[1])


def write(world: World, *points: tuple[float, float]) -> str:
    rows = "".join(f"{x:.4f},{y:.4f}\n" for x, y in points)
    (world.folder / "points.csv").write_text(f"x,y\n{rows}")
    return "points.csv"


def test_a_path_in_the_frame_of_odometry_is_driven_there_and_again_from_its_recording(
    simulated: World,
) -> None:
    simulated.answer_here("drive", "line", "--length", "0.1", "--wait")
    x, y = begin = place(simulated)
    target = (x + 0.3, y + 0.1)
    file = write(simulated, begin, begin, (x + 0.2, y), target, target)
    driven = simulated.answer_here("drive", "path", file, "--frame", "odom", "--wait")
    assert driven["cross_track_max_m"] <= 0.03
    assert distance(place(simulated), target) <= 0.03
    begin = place(simulated)
    again = simulated.answer_here("drive", "path", "last", "--wait")
    assert again["cross_track_max_m"] <= 0.03
    assert again["distance_m"] == pytest.approx(driven["distance_m"], abs=0.05)
    assert distance(place(simulated), begin) == pytest.approx(hypot(0.3, 0.1), abs=0.05)


def test_a_file_whose_points_are_one_place_is_refused_by_name(simulated: World) -> None:
    simulated.here("drive", "path", write(simulated, (1.0, 2.0), (1.0, 2.0), (1.0, 2.0))).failed(
        4, "all points of the path are the same"
    )
    assert simulated.status()["mode"] == "IDLE"


def test_others_hear_a_velocity_for_its_time_and_then_exact_zeros(simulated: World) -> None:
    with Peer(simulated) as peer:
        peer("listen")
        until(lambda: peer("heard")["commands"])
        begun = len(peer("heard")["commands"])
        driven = simulated.answer_here("drive", "velocity", "0.2", "-0.5", "--for", "0.6", "--wait")
        heard = until(lambda: ended(peer("heard")["commands"][begun:]))
    assert driven["duration_s"] == pytest.approx(0.8, abs=0.2)
    speeds = [(linear, angular) for _, _, linear, angular in heard]
    at_speed = [seen_ns for _, seen_ns, *speed in heard if speed == [0.2, -0.5]]
    assert 0.2 <= (at_speed[-1] - at_speed[0]) / 1e9 <= 0.6
    assert max(linear for linear, _ in speeds) == 0.2
    assert min(angular for _, angular in speeds) == -0.5
    assert speeds[-1] == (0.0, 0.0)


def ended(commands: list[Any]) -> list[Any]:
    """Return the commands once the robot was told to move and then to stand, [] before."""
    moved = any(linear or angular for _, _, linear, angular in commands)
    return commands if moved and commands[-1][2:] == [0.0, 0.0] else []


def test_a_path_of_a_node_is_driven_or_refused_by_name(simulated: World, new_peer: NewPeer) -> None:
    planner = new_peer(simulated)
    x, y = place(simulated)
    points = [[x, y], [x + 0.2, y], [x + 0.3, y + 0.1]]
    planner("plan", topic="/plan", points=points, frame="odom")
    driven = simulated.answer_here("drive", "path", "--topic", "plan", "--wait")
    assert driven["distance_m"] == pytest.approx(0.34, abs=0.05)
    planner("plan", topic="/plan", points=[[0.0, 0.0], [0.2, 0.0]], frame="map")
    simulated.here("drive", "path", "--topic", "/plan").failed(4, "frame 'map'")
    simulated.here("drive", "path", "points.csv", "--topic", "plan").failed(2, "not both")
    simulated.here("drive", "square", "--topic", "plan").failed(2, "a square has no --topic")
    file = Path(simulated.answer_here("record", "split")["finished"])
    asked = [each.data for each in entries_of(file) if each.name == "DriveRequested"]
    assert '"reason":"the path of /plan"' in asked[-1]
