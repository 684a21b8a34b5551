"""The ROS services, called by plain rclpy: a stop waits for nobody, no request is lost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.lines import Told
from tests.support.waiting import until
from tests.support.world import (
    PATIENT,
    NewPeer,
    World,
    new_world,
    read_back,
    world_with_daemon,
)

GENTLE = "limits.linear_accel_mps2: 0.1\n"
"""A ramp from 0.1 m/s takes 1 s."""

CALLS = IN_FLIGHT = 600
"""Sixty times rclpy's default queue."""


@pytest.fixture(scope="module")
def gentle() -> Iterator[World]:
    """A world with one daemon, whose robot is slow to stop."""
    with world_with_daemon(settings=PATIENT + GENTLE) as made:
        yield made


def recorded(world: World, name: str) -> int:
    """Return how many messages of a topic were recorded so far."""
    return sum(each["count"] for each in world.status()["topics"] if each["name"] == name)


@pytest.mark.parametrize(("service", "mode"), [("estop", 0), ("set_mode", 3)])
def test_a_stop_does_not_wait_for_an_earlier_ramp(
    gentle: World, new_peer: NewPeer, service: str, mode: int
) -> None:
    peer = new_peer(gentle)
    peer("set_mode", mode=1)
    until(lambda: gentle.status()["velocity"]["linear"] > 0.1)
    ramp = peer("ask", service="set_mode", mode=0)
    until(lambda: gentle.status()["phase"] == "stopping")
    stop = peer("answer", number=peer("ask", service=service, mode=mode))
    assert stop["success"], stop
    cut = peer("answer", number=ramp)
    assert (cut["success"], cut["current_mode"]) == (False, 3)
    assert gentle.status()["mode"] == "EMERGENCY_STOP"
    until(lambda: recorded(gentle, f"/{service}/_service_event") >= 2)
    gentle.ok("reset")


def test_of_a_flood_of_calls_each_is_answered_and_each_stop_is_obeyed(
    gentle: World, new_peer: NewPeer
) -> None:
    flooded: dict[str, Any] = new_peer(gentle)("flood", count=CALLS, in_flight=IN_FLIGHT)
    assert (flooded["sent"], flooded["answered"]) == (CALLS, CALLS)
    assert (flooded["stops"], flooded["obeyed"]) == (CALLS // 3, CALLS // 3)


@pytest.fixture(scope="module")
def manual() -> Iterator[World]:
    """A world with a daemon that does not start by itself."""
    settings = f"{PATIENT}autostart: false\nlimits.linear_accel_mps2: 0.3\n"
    with new_world() as made:
        made.ok("start", "--sim", settings=settings)
        yield made
        made.ok("stop")
        assert read_back(made.recording)["/mode_service/transition_event"]


@pytest.fixture(scope="module")
def caller(manual: World) -> Iterator[Told]:
    """The other process."""
    with manual.peer("LifecyclePeer") as made:
        yield made


def test_a_robot_moves_only_while_its_node_is_active(manual: World, caller: Told) -> None:
    assert caller("state") == "unconfigured"
    manual.robotctl("set-mode", "moving").failed(4, "mode_service is unconfigured, not active")
    assert "mode_service is unconfigured, not active" in manual.status()["warnings"]
    assert caller("change", label="configure")
    assert caller("state") == "inactive"
    assert manual.robotctl("set-mode", "moving").exit_code == 4
    assert caller("change", label="activate")
    assert caller("state") == "active"
    manual.ok("set-mode", "moving")
    until(lambda: manual.status()["velocity"]["linear"] > 0.1)
    assert caller("change", label="deactivate")
    status = until(lambda: (now := manual.status())["mode"] == "IDLE" and now)
    assert status["mode_reason"] == "requested by the lifecycle of /mode_service"
    assert caller("state") == "inactive"
    assert caller("zeros") >= 3, "zeros flow in each state"


def test_a_transition_that_the_state_lacks_changes_nothing(manual: World, caller: Told) -> None:
    before = caller("state")
    assert not caller("change", label="no such label")
    assert not caller("change", id=200)
    assert caller("state") == before
    assert manual.status()["mode"] == "IDLE"


def test_the_cure_activates_the_node(manual: World, caller: Told) -> None:
    name = "mode_service/change_state"
    for label in ("cleanup", "configure", "activate"):
        caller("state")
        manual.here("service", "call", name, f"{{transition: {{label: {label}}}}}")
    assert caller("state") == "active"
    assert not any("not active" in warning for warning in manual.status()["warnings"])
