"""`robotctl doctor` beside real ROS processes."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.waiting import until
from tests.support.world import NewPeer, World, world_with_daemon


def findings(world: World, *options: str) -> list[dict[str, Any]]:
    """Return the findings, whatever the exit code is."""
    found: list[dict[str, Any]] = world.here("doctor", *options, "--json").summary["findings"]
    return found


@pytest.fixture(scope="module")
def simulated() -> Iterator[World]:
    """A world with one daemon, which records elsewhere."""
    with world_with_daemon("--sim", "--recordings", "elsewhere") as made:
        yield made


def test_the_disk_is_the_one_on_which_the_daemon_records(simulated: World) -> None:
    (disk,) = (each["text"] for each in findings(simulated) if each["check"] == "disk")
    assert disk.endswith(f"GB free for recordings in {simulated.folder / 'elsewhere'}")


def test_a_daemon_and_its_robot_are_healthy_and_a_base_of_another_type_is_named(
    simulated: World, new_peer: NewPeer
) -> None:
    found = simulated.answer_here("doctor")["findings"]
    assert [each for each in found if each["level"] == "fault"] == []
    told = {each["check"]: each["text"] for each in found}
    assert told["odometry"].startswith("/odom (nav_msgs/msg/Odometry): 1 publishers")
    new_peer(simulated)("take_commands", kind="TwistStamped")

    def sick() -> str:
        ran = simulated.here("doctor", "--json")
        return ran.out if ran.exit_code == 4 else ""

    answer = json.loads(until(sick))  # once the daemon has discovered it
    faults = [each for each in answer["findings"] if each["level"] == "fault"]
    assert ["several types" in each["text"] and each["check"] for each in faults] == ["command"]
    assert answer["error"]["cure"] == faults[0]["cure"]


def test_what_a_kill_left_is_cleaned_and_a_shell_in_another_domain_is_told(world: World) -> None:
    world.ok("start", "--sim", "--robot", "r2")
    world.ok("start", "--sim")
    world.kill(world.status("r2")["pid"])
    found = findings(world)
    (left,) = (each for each in found if "robot r2" in each["text"])
    assert left["level"] == "warning"
    sockets = {path.name: path for path in world.sockets()}
    answer = world.here("doctor", "--clean", "--json").summary
    assert str(sockets["r2.sock"]) in answer["removed"]
    assert [path.name for path in world.sockets()] == ["robot.sock"]
    assert not [each for each in answer["findings"] if "robot r2" in each["text"]]
    assert world.status()["mode"] == "IDLE"
    world.environment["ROS_DOMAIN_ID"] = "0"
    elsewhere = findings(world)
    (told,) = (each for each in elsewhere if each["check"] == "discovery" and each["cure"])
    assert told["cure"] == f"export ROS_DOMAIN_ID={world.domain_id}"
    world.ok("stop")


def test_a_graph_that_cannot_be_seen_is_a_fault_with_a_cure(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_STATIC_PEERS", "no-such-machine.invalid")
    (told,) = (each for each in findings(world) if each["level"] == "fault")
    assert told["check"] == "ROS"
    assert told["cure"]


@pytest.mark.slow
def test_a_daemon_that_hangs_is_named(world: World) -> None:
    world.ok("start", "--sim")
    pid = world.status()["pid"]
    os.kill(pid, signal.SIGSTOP)
    try:
        ran = world.here("doctor")
    finally:
        os.kill(pid, signal.SIGCONT)
    ran.failed(4, out="the daemon of robot 'robot' did not answer")
    world.ok("stop")
