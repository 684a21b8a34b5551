"""The lease with the real daemon: three clients, a ROS node, and a holder that is killed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from signal import SIGCONT, SIGINT, SIGSTOP
from unittest.mock import PropertyMock

import pytest

from robotctl.cli.targets.driving import HeldLease
from tests.support.lines import line_of
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import ROBOTCTL, NewPeer, World, new_world


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with one daemon, whose robot stands and whose lease is free between the tests."""
    with new_world() as made:
        made.ok("start", "--sim")
        yield made
        made.ok("stop")
        (report,) = made.answer("replay", "last", "--check")["recordings"]
        assert (report["verdict"], report["notes"]) == ("same", [])


def test_the_holder_alone_moves_the_robot_and_its_death_ramps_it_down(
    world: World, new_peer: NewPeer
) -> None:
    holder = world.spawn("lease", "take", "--reason", "inspection")
    told = line_of(holder.stdout)
    found = re.search(r"ROBOTCTL_LEASE=(\w+)", told)
    assert found, told
    world.robotctl("lease", "take").failed(4, f"pid {holder.pid}) holds the lease (inspection)")
    for asked in ("set-mode moving", "drive circle", "lease release"):
        err = world.robotctl(*asked.split()).failed(4)
        assert re.search(r"holds the lease \(inspection\), and robotctl .* asked", err)
    over_ros = new_peer(world)("set_mode", mode=1)
    assert not over_ros["success"]
    assert "and the ROS service /set_mode asked" in over_ros["message"]
    world.environment["ROBOTCTL_LEASE"] = found[1]
    assert world.answer("lease", "status")["yours"] is True
    world.ok("drive", "circle", "--reason", "the first lap")
    status = world.status()
    assert status["mode"] == "MOVING"
    assert f"pid {holder.pid})" in status["lease"]
    assert "the first lap" in status["mode_reason"]
    holder.kill()
    holder.communicate()
    until(lambda: world.status()["mode"] == "IDLE")
    told = world.status()["mode_reason"]
    assert "lost the lease: its connection closed" in told
    del world.environment["ROBOTCTL_LEASE"]
    third = world.spawn("lease", "take")
    assert line_of(third.stdout).startswith("Lease taken.")
    third.send_signal(SIGINT)  # however soon after the line
    out, _ = third.communicate(timeout=DEADLINE_S)
    assert (third.returncode, "Lease released" in out) == (0, True)
    world.robotctl("lease", "take", "--", ROBOTCTL, "lease", "status", "--json").succeeded(
        '"yours": true'
    )
    world.ok("set-mode", "moving")
    world.ok("set-mode", "idle")


def test_ctrl_c_while_the_lease_is_taken_releases_it(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", world.environment["XDG_RUNTIME_DIR"])
    monkeypatch.setattr(HeldLease, "_keep", PropertyMock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt), HeldLease("robot", "test"):
        pass
    assert world.answer("lease", "status")["holder"] is None


def test_a_frozen_holder_loses_the_lease_and_the_robot_ramps_down(world: World) -> None:
    holder = world.spawn("lease", "take")
    world.environment["ROBOTCTL_LEASE"] = line_of(holder.stdout).rstrip().split("=")[1]
    world.ok("drive", "circle")
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    holder.send_signal(SIGSTOP)
    until(lambda: world.status()["mode"] == "IDLE")
    assert "lost the lease: nothing was heard from it for 1 s" in world.status()["mode_reason"]
    assert world.answer("lease", "status")["holder"] is None
    holder.send_signal(SIGCONT)
    _, err = holder.communicate(timeout=DEADLINE_S)
    assert (holder.returncode, "lost the lease" in err) == (4, True), err
