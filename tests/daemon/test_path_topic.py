"""`robotctl drive path --topic`: the path of another node, driven by the real daemon."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.support.waiting import until
from tests.support.world import Peer, World, entries_of


def test_the_path_of_a_node_is_driven_or_refused_by_name(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim")
    until(lambda: world.status()["pose"] is not None and world.status()["battery"] is not None)
    planner = new_peer(world)
    planner("plan", topic="/plan", points=[[0.0, 0.0], [0.2, 0.0], [0.3, 0.1]], frame="odom")
    driven = world.answer("drive", "path", "--topic", "plan", "--wait")
    assert driven["distance_m"] == pytest.approx(0.34, abs=0.05)
    planner("plan", topic="/plan", points=[[0.0, 0.0], [0.2, 0.0]], frame="map")
    refused = world.robotctl("drive", "path", "--topic", "/plan")
    assert (refused.exit_code, "frame 'map'" in refused.err) == (4, True), refused
    both = world.here("drive", "path", "points.csv", "--topic", "plan")
    assert (both.exit_code, "not both" in both.err) == (2, True)
    other = world.here("drive", "square", "--topic", "plan")
    assert (other.exit_code, "a square has no --topic" in other.err) == (2, True)
    world.ok("stop")
    (file,) = world.recordings.glob("*/*.mcap")
    (asked,) = (each for each in entries_of(file) if each.name == "DriveRequested")
    assert '"reason":"the path of /plan"' in asked.data
