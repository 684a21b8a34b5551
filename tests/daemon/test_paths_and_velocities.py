"""`robotctl drive path` and `drive velocity`, driven by the real daemon and its simulated robot."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot
from typing import Any

import pytest

from tests.support.waiting import until
from tests.support.world import Peer, World, new_world


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A robot for all of this module."""
    with new_world() as made:
        made.ok("start", "--sim")
        until(lambda: made.status()["pose"] is not None and made.status()["battery"] is not None)
        yield made
        made.ok("stop")


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
    world: World,
) -> None:
    world.answer_here("drive", "line", "--length", "0.1", "--wait")
    x, y = begin = place(world)
    target = (x + 0.3, y + 0.1)
    file = write(world, begin, begin, (x + 0.2, y), target, target)
    driven = world.answer_here("drive", "path", file, "--frame", "odom", "--wait")
    assert driven["cross_track_max_m"] <= 0.03
    assert distance(place(world), target) <= 0.03
    begin = place(world)
    again = world.answer_here("drive", "path", "last", "--wait")
    assert again["cross_track_max_m"] <= 0.03
    assert again["distance_m"] == pytest.approx(driven["distance_m"], abs=0.05)
    assert distance(place(world), begin) == pytest.approx(hypot(0.3, 0.1), abs=0.05)


def test_a_file_whose_points_are_one_place_is_refused_by_name(world: World) -> None:
    refused = world.here("drive", "path", write(world, (1.0, 2.0), (1.0, 2.0), (1.0, 2.0)))
    assert (refused.exit_code, "all points of the path are the same" in refused.err) == (4, True)
    assert world.status()["mode"] == "IDLE"


def test_another_process_hears_a_velocity_for_its_time_and_then_exact_zeros(world: World) -> None:
    peer = Peer(world)
    try:
        peer("listen")
        until(lambda: peer("heard")["commands"])
        begun = len(peer("heard")["commands"])
        driven = world.answer_here("drive", "velocity", "0.2", "-0.5", "--for", "0.6", "--wait")
        heard = until(lambda: ended(peer("heard")["commands"][begun:]))
    finally:
        peer.close()
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
