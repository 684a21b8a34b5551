"""The lifecycle services, called by plain rclpy in another process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import PATIENT, World, new_world, read_back


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with a daemon that does not start by itself."""
    with new_world() as made:
        config = made.folder / "manual.yaml"
        config.write_text(f"{PATIENT}autostart: false\nlimits.linear_accel_mps2: 0.3\n")
        made.ok("start", "--sim", "--config", str(config))
        yield made
        made.ok("stop")
        (folder,) = made.recordings.iterdir()
        topics = read_back(folder)
        assert topics["/mode_service/transition_event"]


@pytest.fixture(scope="module")
def peer(world: World) -> Iterator[Told]:
    """The other process."""
    with closing(
        Told(peer_command("tests.support.role_peers", "LifecyclePeer"), world.environment)
    ) as made:
        yield made


def test_a_robot_moves_only_while_its_node_is_active(world: World, peer: Told) -> None:
    assert peer("state") == "unconfigured"
    refused = world.robotctl("set-mode", "moving")
    assert refused.exit_code == 4
    assert "mode_service is unconfigured, not active" in refused.err
    assert "mode_service is unconfigured, not active" in world.status()["warnings"]
    assert peer("change", label="configure")
    assert peer("state") == "inactive"
    assert world.robotctl("set-mode", "moving").exit_code == 4
    assert peer("change", label="activate")
    assert peer("state") == "active"
    world.ok("set-mode", "moving")
    until(lambda: world.status()["velocity"]["linear"] > 0.1)
    assert peer("change", label="deactivate")
    status = until(lambda: (now := world.status())["mode"] == "IDLE" and now)
    assert status["mode_reason"] == "requested by the lifecycle of /mode_service"
    assert peer("state") == "inactive"
    assert peer("zeros") >= 3, "zeros flow in each state"


def test_a_transition_that_the_state_does_not_have_changes_nothing(
    world: World, peer: Told
) -> None:
    before = peer("state")
    assert not peer("change", label="no such label")
    assert not peer("change", id=200)
    assert peer("state") == before
    assert world.status()["mode"] == "IDLE"


def test_the_state_machine_is_that_of_ros(peer: Told) -> None:
    states, transitions, graph = peer("machine")
    assert {"unconfigured", "inactive", "active", "finalized"} <= set(states)
    assert "activate" in graph
    assert set(transitions) <= set(graph)


def test_the_cure_activates_the_node(world: World, peer: Told) -> None:
    name = "mode_service/change_state"
    for label in ("cleanup", "configure", "activate"):
        peer("state")
        world.robotctl("service", "call", name, f"{{transition: {{label: {label}}}}}")
    assert peer("state") == "active"
    assert not any("not active" in warning for warning in world.status()["warnings"])
