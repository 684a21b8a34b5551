"""What must hold before a motion: the list of it, and an emergency stop as an input.
A base that is commissioned: in its own process, and the simulated one.
"""

from __future__ import annotations

import asyncio
import json
import re
from signal import SIGINT, SIGKILL, Signals
from typing import Any
from unittest.mock import Mock

import pytest

from robotctl.base.errors import Interrupted, Refused
from robotctl.cli.commands import commission
from robotctl.daemon import driver
from robotctl.kernel.patterns import PatternKind
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, InProcess, NewPeer, World


def test_an_emergency_stop_topic_stops_a_drive_and_is_a_condition_of_the_next(
    world: World, new_peer: NewPeer
) -> None:
    peer = new_peer(world)
    settings = f"{PATIENT}inputs.estop.use: optional\n"
    world.ok("start", "--sim", "--drive", "circle", settings=settings)
    assert "FAILED" not in world.here("preflight").out

    def stops() -> bool:
        peer("press", topic="/estop_pressed", pressed=True)
        return bool(world.status()["mode"] == "EMERGENCY_STOP")

    until(stops)
    refused = world.here("preflight")
    refused.failed(4, "release the button", out="FAILED  emergency stop inputs released")
    assert "the emergency stop on estop_pressed is pressed" in refused.out
    assert world.here("reset").exit_code == 4

    def releases() -> bool:
        peer("press", topic="/estop_pressed", pressed=False)
        return world.here("reset").exit_code == 0

    until(releases)
    assert world.answer_here("preflight")["passed"] is True
    world.ok("stop")


async def test_without_a_robot_a_start_is_ready_and_says_what_is_missing_and_a_preflight_waits(
    in_process: InProcess, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "READY_S", 0.1)
    async with in_process(sim=False, drive=PatternKind.SQUARE) as daemon:
        notes = "\n".join(daemon.started["notes"])
        for text in (
            "no robot to drive yet: no odometry was received on odom yet",
            "no robot to drive yet: no battery level was received on battery_state yet",
            "no robot to drive yet: no node subscribes to cmd_vel",
            "check that the robot publishes odometry",  # why the drive is refused
        ):
            assert text in notes
        status = await daemon.ask("status")
        assert (status["mode"], status["sim"]) == ("IDLE", False)
        assert (status["pose"], status["battery"]) == (None, None)
        with pytest.raises(Refused, match="no odometry was received on odom yet"):
            await daemon.ask("set_mode", mode=1, source="test")
        conditions = (await daemon.ask("preflight"))["conditions"]
        problems = {each["cause"]: each for each in conditions if each["problem"]}
        assert {"odometry lost", "battery unknown"} <= set(problems)
        assert "check that the robot publishes odometry" in problems["odometry lost"]["cure"]
        waiting = world.spawn("preflight", "--wait", "600")
        sim = world.spawn("sim")
        out, err = await asyncio.to_thread(waiting.communicate)
        assert waiting.returncode == 0, err
        assert "passed  odometry fresh" in out
        sim.terminate()
        await asyncio.to_thread(sim.communicate)


def test_an_input_of_another_type_prevents_motion_and_status_names_the_types(
    world: World, new_peer: NewPeer
) -> None:
    new_peer(world)("publish", kind="Twist", topic="estop_pressed")
    settings = "inputs.estop.use: required\n"
    start = world.spawn("start", "--sim", settings=settings)  # waits for the input
    until(lambda: world.here("status").exit_code == 0)
    types = "geometry_msgs/msg/Twist, std_msgs/msg/Bool"
    until(lambda: any(types in text for text in world.status()["warnings"]))
    world.here("set-mode", "moving").failed(4, "nothing was received on estop_pressed")
    world.ok("stop")
    start.communicate()


BASE: dict[str, Any] = {
    "command": ["cmd_vel", "TwistStamped", "system"],
    "odometry": ["odom", "system", 10],
    "battery": None,
    "child_frame": "base_link",
    "lag_s": 0.3,
    "deadband_mps": 0.05,
}


@pytest.mark.slow
def test_a_base_of_10_hz_with_lag_and_deadband_and_no_timeout_is_told_as_such(world: World) -> None:
    settings = f"{PATIENT}battery.topic: ''\ncommand.stamped: true\n"
    with world.peer("StubBase") as base:
        base("begin", **BASE)
        world.ok("start", "--no-sim", settings=settings)
        world.ok("preflight", "--wait", "30")
        told = world.answer("commission", "--yes", "--out", "proposed.yaml")
        assert base("driven")["x"] > 0.2
        assert told["measured"]["base_timeout_s"] is None
        assert "without a command" in told["warnings"][0]
        assert told["measured"]["command_delay_s"] > 0.1
        assert told["proposed"]["tracking.lag_s"] > 0.1
        assert told["measured"]["turn"]["command_delay_s"] > 0.1
        assert told["proposed"]["limits.angular_rps"] > 0.1
        valid = world.answer("config", "validate", "proposed.yaml")
        assert valid["changed"]["command.stamped"] == "true"
        assert "tracking.lag_s" in valid["changed"]
        world.robotctl("commission", "--yes", "--out", "proposed.yaml").failed(2, "exists already")
        assert world.status()["mode"] == "IDLE"
        assert world.answer("lease", "status")["holder"] is None
        world.ok("stop")
        why = world.answer("why", "last")
        assert "0.3 rad/s for 12 s: robotctl commission" in why["asked"]


def test_nobody_is_asked_without_a_terminal_and_nothing_moves(simulated: World) -> None:
    asked = simulated.here("commission", "--json")
    assert asked.exit_code == 2
    assert json.loads(asked.out)["error"]["cure"] == "give --yes"
    simulated.here("commission", "--yes", "--out", "nowhere/robot.yaml").failed(
        2, "nowhere cannot be written to"
    )
    holder = simulated.spawn("lease", "take")
    until(lambda: simulated.answer_here("lease", "status")["holder"] is not None)
    err = simulated.here("commission", "--yes").failed(4)
    assert re.search(r"lease take .* holds the lease, and robotctl commission .* asked", err)
    holder.send_signal(SIGINT)
    holder.communicate(timeout=DEADLINE_S)
    simulated.here("set-mode", "error")
    simulated.here("commission", "--yes").failed(4, "reset")
    simulated.ok("reset")


def test_ctrl_c_while_a_motion_is_requested_stops_it(monkeypatch: pytest.MonkeyPatch) -> None:
    requested = Mock(start=Mock(side_effect=KeyboardInterrupt))
    monkeypatch.setattr(commission, "Background", lambda request: requested)
    monkeypatch.setattr(commission, "stop_drive", lambda robot, driving: Interrupted())
    with pytest.raises(Interrupted):
        commission._drive("robot", {})


@pytest.mark.parametrize("number", [SIGINT, SIGKILL])
def test_an_interrupted_commissioning_stops_the_robot(simulated: World, number: Signals) -> None:
    command = simulated.spawn("commission", "--yes")
    until(lambda: simulated.status()["velocity"]["linear"] > 0.05)
    command.send_signal(number)
    until(lambda: simulated.status()["mode"] == "IDLE")
    if number is SIGINT:
        _, err = command.communicate(timeout=DEADLINE_S)
        assert command.returncode == 130, err
    command.kill()
    command.communicate()
