"""A joystick drives while robotctl is silent in IDLE, and the daemon drives when it rests."""

from __future__ import annotations

from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import PATIENT, World

SETTINGS = f"""{PATIENT}
command: {{when_idle: silent, foreign: yield}}
"""


def test_others_drive_in_idle_and_a_start_waits_until_they_are_quiet(world: World) -> None:
    settings = world.folder / "shared.yaml"
    settings.write_text(SETTINGS)
    world.ok("start", "--sim", "--config", str(settings))
    joystick = Told(peer_command("tests.support.role_peers", "MuxPeer"), world.environment)
    try:
        joystick("want", topic="/cmd_vel", linear=0.2)
        until(lambda: world.status()["velocity"]["linear"] > 0.18)
        assert world.status()["mode"] == "IDLE"
        until(lambda: _refused_by_name(world))
        joystick("rest")
        until(lambda: world.robotctl("set-mode", "moving").exit_code == 0)
        joystick("want", topic="/cmd_vel", linear=0.2)
        until(lambda: world.status()["mode"] == "ERROR")
        assert "planner" in world.status()["mode_reason"]
        joystick("rest")
        until(lambda: world.status()["velocity"]["linear"] < 0.01)
        until(lambda: world.robotctl("reset").exit_code == 0)
    finally:
        joystick.close()
    world.ok("stop")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert report["verdict"] == "same"
    assert [text for text in report["notes"] if "published as well" not in text] == []


def _refused_by_name(world: World) -> bool:
    """Whether a start is refused with the name of the node, which may come after its commands."""
    refused = world.robotctl("set-mode", "moving")
    assert refused.exit_code == 4, refused
    return "planner" in refused.err
