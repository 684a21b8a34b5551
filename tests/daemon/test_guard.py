"""A planner steers through the guard of the daemon, and a twist_mux takes its lock."""

from __future__ import annotations

from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import PATIENT, World

SETTINGS = f"""{PATIENT}
guard: true
guard_timeout_s: 2.0
command.lock_topic: robotctl/lock
"""
"""A timeout that a busy machine keeps."""


def test_a_planner_steers_in_moving_only_and_an_emergency_stop_locks_the_mux(world: World) -> None:
    settings = world.folder / "guard.yaml"
    settings.write_text(SETTINGS)
    world.ok("start", "--sim", "--config", str(settings))
    planner = Told(peer_command("tests.support.role_peers", "MuxPeer"), world.environment)
    try:
        planner("mux", lock="/robotctl/lock", wanted="/cmd_vel_nav")
        planner("want", topic="/cmd_vel_nav", linear=0.2)
        until(lambda: planner("state")["passed"])
        assert world.status()["velocity"]["linear"] < 0.01
        assert "guarding cmd_vel_nav" in world.ok("set-mode", "moving")
        until(lambda: world.status()["velocity"]["linear"] > 0.15)
        world.ok("set-mode", "idle")
        world.ok("set-mode", "moving")
        until(lambda: world.status()["velocity"]["linear"] > 0.15)
        planner("rest")
        until(lambda: world.status()["velocity"]["linear"] < 0.01)
        assert world.status()["mode"] == "MOVING"
        world.ok("estop")
        until(lambda: planner("state")["locked"])
        world.ok("reset")
        until(lambda: planner("state")["locked"] is False)
    finally:
        planner.close()
    world.ok("stop")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert report["verdict"] == "same"
    # What others want while the robot is not guarded is recorded, and is no input.
    assert not [text for text in report["notes"] if "did not reach" in text]
