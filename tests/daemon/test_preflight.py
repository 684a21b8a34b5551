"""What must hold before a motion: the list of it, and an emergency stop as an input."""

from __future__ import annotations

import json

from tests.support.waiting import until
from tests.support.world import PATIENT, NewPeer, World


def test_an_emergency_stop_topic_stops_a_drive_and_is_a_condition_of_the_next(
    world: World, new_peer: NewPeer
) -> None:
    peer = new_peer(world)
    settings = world.folder / "button.yaml"
    settings.write_text(f"{PATIENT}inputs.estop.use: optional\n")
    world.ok("start", "--sim", "--drive", "circle", "--config", str(settings))
    assert "FAILED" not in world.ok("preflight")

    def stops() -> bool:
        peer("press", topic="/estop_pressed", pressed=True)
        return bool(world.status()["mode"] == "EMERGENCY_STOP")

    until(stops)
    failed = world.robotctl("preflight")
    assert failed.exit_code == 4
    assert "FAILED  emergency stop inputs released" in failed.out
    assert "the emergency stop on estop_pressed is pressed" in failed.out
    assert "release the button" in failed.err
    assert world.robotctl("reset").exit_code == 4

    def releases() -> bool:
        peer("press", topic="/estop_pressed", pressed=False)
        return world.robotctl("reset").exit_code == 0

    until(releases)
    assert json.loads(world.ok("preflight", "--json"))["passed"] is True
    world.ok("stop")


def test_without_a_robot_a_start_is_ready_and_says_what_is_missing_and_a_preflight_waits(
    world: World,
) -> None:
    out = world.ok("start", "--no-sim", "--drive", "square")
    for text in (
        "note: no robot to drive yet: no odometry was received on odom yet",
        "note: no robot to drive yet: no battery level was received on battery_state yet",
        "note: no robot to drive yet: no node subscribes to cmd_vel",
        "check that the robot publishes odometry",  # why the drive is refused
    ):
        assert text in out
    status = world.status()
    assert (status["mode"], status["sim"]) == ("IDLE", False)
    assert (status["pose"], status["battery"]) == (None, None)
    refused = world.here("set-mode", "moving")
    assert (refused.exit_code, refused.out) == (4, "")
    assert "no odometry was received on odom yet" in refused.err
    failed = world.here("preflight", "--json")
    assert failed.exit_code == 4
    conditions = json.loads(failed.out)["conditions"]
    problems = {each["cause"]: each for each in conditions if each["problem"]}
    assert {"odometry lost", "battery unknown"} <= set(problems)
    assert "check that the robot publishes odometry" in problems["odometry lost"]["cure"]
    waiting = world.spawn("preflight", "--wait", "600")
    sim = world.spawn("sim")
    out, err = waiting.communicate()
    assert waiting.returncode == 0, err
    assert "passed  odometry fresh" in out
    sim.terminate()
    sim.communicate()
    world.ok("stop")


def test_an_input_of_another_type_prevents_motion_and_status_names_the_types(
    world: World, new_peer: NewPeer
) -> None:
    new_peer(world)("publish", kind="Twist", topic="estop_pressed")
    settings = world.folder / "odd.yaml"
    settings.write_text("inputs.estop.use: required\n")
    start = world.spawn("start", "--sim", "--config", str(settings))  # waits for the input
    until(lambda: world.here("status").exit_code == 0)
    types = "geometry_msgs/msg/Twist, std_msgs/msg/Bool"
    until(lambda: any(types in text for text in world.status()["warnings"]))
    refused = world.here("set-mode", "moving")
    assert refused.exit_code == 4
    assert "nothing was received on estop_pressed" in refused.err
    world.ok("stop")
    start.communicate()
