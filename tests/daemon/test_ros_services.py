"""The ROS services: a stop waits for no other request, and no request is lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.waiting import until
from tests.support.world import PATIENT, Peer, World

GENTLE = "limits.linear_accel_mps2: 0.03\n"
"""A ramp from 0.1 m/s takes 3 s."""

CALLS = 3_000
IN_FLIGHT = 1_000
"""A hundred times rclpy's default queue."""

NewPeer = Callable[[World], Peer]


@pytest.mark.parametrize(("service", "mode"), [("estop", 0), ("set_mode", 3)])
def test_a_stop_does_not_wait_for_an_earlier_ramp(
    world: World, new_peer: NewPeer, service: str, mode: int
) -> None:
    gentle = world.folder / "gentle.yaml"
    gentle.write_text(PATIENT + GENTLE)
    world.ok("start", "--sim", "--config", str(gentle))
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
    topics = {topic["name"]: topic["count"] for topic in world.status()["topics"]}
    assert topics[f"/{service}/_service_event"] >= 2
    world.ok("stop")


def test_of_a_flood_of_calls_each_is_answered_and_each_stop_is_obeyed(
    world: World, new_peer: NewPeer
) -> None:
    world.ok("start", "--sim")
    flooded: dict[str, Any] = new_peer(world)("flood", count=CALLS, in_flight=IN_FLIGHT)
    assert (flooded["sent"], flooded["answered"]) == (CALLS, CALLS)
    assert (flooded["stops"], flooded["obeyed"]) == (CALLS // 3, CALLS // 3)
    world.ok("stop")
