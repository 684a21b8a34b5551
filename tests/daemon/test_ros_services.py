"""The ROS services: a stop waits for no other request, and no request is lost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.support.waiting import until
from tests.support.world import PATIENT, Peer, World, new_world

GENTLE = "limits.linear_accel_mps2: 0.03\n"
"""A ramp from 0.1 m/s takes 3 s."""

CALLS = 1_500
IN_FLIGHT = 1_000
"""A hundred times rclpy's default queue."""

NewPeer = Callable[[World], Peer]


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with one daemon, whose robot is slow to stop."""
    with new_world() as made:
        gentle = made.folder / "gentle.yaml"
        gentle.write_text(PATIENT + GENTLE)
        made.ok("start", "--sim", "--config", str(gentle))
        yield made
        made.ok("stop")


def recorded(world: World, name: str) -> int:
    """Return how many messages of a topic were recorded so far."""
    return sum(each["count"] for each in world.status()["topics"] if each["name"] == name)


@pytest.mark.parametrize(("service", "mode"), [("estop", 0), ("set_mode", 3)])
def test_a_stop_does_not_wait_for_an_earlier_ramp(
    world: World, new_peer: NewPeer, service: str, mode: int
) -> None:
    peer = new_peer(world)
    peer("set_mode", mode=1)
    until(lambda: world.status()["velocity"]["linear"] > 0.1)
    ramp = peer("ask", service="set_mode", mode=0)
    until(lambda: world.status()["phase"] == "stopping")
    stop = peer("answer", number=peer("ask", service=service, mode=mode))
    assert stop["success"], stop
    cut = peer("answer", number=ramp)
    assert (cut["success"], cut["current_mode"]) == (False, 3)
    assert world.status()["mode"] == "EMERGENCY_STOP"
    until(lambda: recorded(world, f"/{service}/_service_event") >= 2)
    world.ok("reset")


def test_of_a_flood_of_calls_each_is_answered_and_each_stop_is_obeyed(
    world: World, new_peer: NewPeer
) -> None:
    flooded: dict[str, Any] = new_peer(world)("flood", count=CALLS, in_flight=IN_FLIGHT)
    assert (flooded["sent"], flooded["answered"]) == (CALLS, CALLS)
    assert (flooded["stops"], flooded["obeyed"]) == (CALLS // 3, CALLS // 3)
