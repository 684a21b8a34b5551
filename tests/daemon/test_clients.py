"""Commands that start and end while the daemon runs, several at once."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from tests.support.waiting import DEADLINE_S, until
from tests.support.world import World, new_world


@pytest.fixture(scope="module")
def shared() -> Iterator[World]:
    """A world with one daemon, whose robot stands in IDLE between the tests."""
    with new_world() as made:
        made.ok("start", "--sim")
        yield made
        made.ok("stop")


def test_a_killed_waiting_client_ends_its_drive_and_the_next_client_sees_the_end(
    world: World,
) -> None:
    world.ok("start", "--sim")
    first = world.spawn("drive", "square", "--wait")
    until(lambda: world.status()["mode"] == "MOVING")
    first.kill()
    first.communicate()
    until(lambda: world.status()["mode"] == "IDLE")
    second = world.spawn("drive", "circle", "--wait")
    until(lambda: world.status()["mode"] == "MOVING")
    world.ok("stop")
    _, err = second.communicate(timeout=DEADLINE_S)
    assert second.returncode == 4
    assert "the drive ended after 0 laps: requested by the daemon's end" in err


def test_a_waited_drive_that_a_fault_ends_is_an_error(shared: World) -> None:
    for options in ((), ("--json",)):
        drive = shared.spawn("drive", "square", "--wait", *options)
        until(lambda: shared.status()["velocity"]["linear"] > 0.1)
        shared.ok("estop")
        out, err = drive.communicate(timeout=DEADLINE_S)
        assert drive.returncode == 4
        assert "the drive ended after 0 laps: requested by robotctl estop" in err
        if options:
            found = json.loads(out)
            assert (found["laps"], found["error"]["kind"]) == (0, "refused")
            assert found["distance_m"] > 0.0
        else:
            assert "driven      0 laps, 0." in out
        shared.ok("reset")


def test_the_cures_of_a_named_robot_work_when_they_are_pasted(world: World) -> None:
    world.ok("start", "--sim", "--robot", "r2")
    world.ok("set-mode", "error", "--robot", "r2")
    refused = world.robotctl("drive", "square", "--robot", "r2", "--json")
    assert refused.exit_code == 4
    cure = json.loads(refused.out)["error"]["cure"]
    assert cure == "clear it: robotctl reset --robot r2"
    assert world.answer("why", "--robot", "r2")["what"].endswith(cure)
    world.ok(*cure.split("robotctl ")[1].split())
    world.ok("stop", "--robot", "r2")


def test_why_answers_while_the_daemon_runs_and_names_its_evidence(world: World) -> None:
    world.ok("start", "--sim")
    world.ok("drive", "square")
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    world.ok("estop")
    until(lambda: world.robotctl("why").exit_code == 0)  # the recording holds it a moment later
    told = world.answer("why")
    assert (told["kind"], told["mode"]) == ("stop", "EMERGENCY_STOP")
    assert "a request for EMERGENCY_STOP by robotctl estop" in told["came_in"]
    assert "a square: robotctl drive" in told["asked"]
    assert told["zero_after_ms"] >= 0.0
    world.ok("stop")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert (report["verdict"], report["notes"]) == ("same", [])
    assert report["commands"] > 0


def test_a_drive_while_moving_is_refused_unless_it_replaces(shared: World) -> None:
    shared.ok("drive", "circle", "--laps", "0")
    refused = shared.robotctl("drive", "square")
    assert refused.exit_code == 4
    assert "--replace" in refused.err
    shared.ok("drive", "square", "--replace")
    assert shared.status()["mode"] == "MOVING"
    shared.ok("set-mode", "idle")
