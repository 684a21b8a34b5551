"""After any end of the daemon the robot has stopped, recording and latch are complete."""

from __future__ import annotations

import os
import signal
import socket
import time

import pytest

from robotctl.check.compare import first_divergence
from robotctl.kernel.types import ModeChanged
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, World, journal_of, read_back


def test_an_emergency_stop_outlives_a_kill_and_a_stop_and_is_left_by_reset_only(
    world: World,
) -> None:
    latch = world.folder / "state" / "robotctl" / "robot" / "emergency-stop"
    world.ok("start", "--sim", "--drive", "circle")
    until(lambda: world.status()["recorder"]["written"] > 100)
    assert "release it with: robotctl reset" in world.ok("estop")
    assert latch.exists()
    world.here("set-mode", "moving").failed(4, "EMERGENCY_STOP", "robotctl reset")
    world.kill(world.status()["pid"])
    assert world.sockets() != []
    assert world.robotctl("status").exit_code == 3
    killed = world.recording
    assert "the emergency stop is still latched" in world.ok("start", "--sim")
    assert world.status()["mode"] == "EMERGENCY_STOP"
    until(lambda: f"repaired: {killed.name}_0.mcap" in world.log())
    world.ok("stop")
    journal = journal_of(killed)
    assert any(entry.name == ModeChanged.__name__ for entry in journal)
    assert first_divergence(journal) is None
    world.ok("start", "--sim")
    assert world.status()["mode"] == "EMERGENCY_STOP"
    assert "requested by robotctl estop" in world.status()["mode_reason"]
    assert "released" in world.ok("reset")
    assert not latch.exists()
    stops = [world.spawn("stop") for _ in range(2)]
    for process in stops:
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode in (0, 3), err
    assert world.here("stop").exit_code == 3


def test_a_latch_that_cannot_be_written_is_reported_and_the_robot_stops(simulated: World) -> None:
    partial = simulated.folder / "state" / "robotctl" / "robot" / "emergency-stop.new"
    partial.mkdir()  # the path of the latch's temporary file
    ran = simulated.robotctl("estop")
    ran.failed(1, "Mode changed to EMERGENCY_STOP, but a restart would forget this stop")
    assert ran.out == ""
    status = simulated.status()
    assert status["mode"] == "EMERGENCY_STOP"
    (warning,) = (text for text in status["warnings"] if "could not be saved" in text)
    assert warning.endswith("(tried again each second)")
    partial.rmdir()
    until(lambda: not any("saved" in text for text in simulated.status()["warnings"]))
    assert partial.with_suffix("").read_text().startswith("requested by robotctl estop")
    assert simulated.robotctl("estop").exit_code == 0
    simulated.ok("reset")


def test_a_stop_answers_with_any_owner_of_the_latch_folder(simulated: World) -> None:
    if os.getuid() != 0:
        pytest.skip("only root gives a folder away")
    simulated.ok("drive", "circle")
    folder = simulated.folder / "state" / "robotctl" / "robot"
    os.chown(folder, 4711, 4711)
    for _ in range(2):
        asked = time.monotonic()
        ran = simulated.robotctl("estop")
        assert time.monotonic() - asked < 10.0, "as long as a client waits for a silent daemon"
        ran.failed(1, f"{folder} belongs to", "a restart would forget this stop")
    assert simulated.status()["mode"] == "EMERGENCY_STOP"
    os.chown(folder, 0, 0)
    until(lambda: (folder / "emergency-stop").exists())
    simulated.ok("reset")


def test_a_battery_stop_is_released_by_a_charged_battery_only_also_after_a_restart(
    world: World,
) -> None:
    def start(level: float, life_s: float, *options: str) -> None:
        settings = f"{PATIENT}sim.battery_start: {level}\nsim.battery_life_s: {life_s}\n"
        world.ok("start", "--sim", *options, settings=settings)

    start(0.155, 100.0, "--drive", "circle")
    until(lambda: world.status()["mode"] == "EMERGENCY_STOP")
    assert "at or below 15%" in world.status()["mode_reason"]
    world.ok("stop")
    start(0.165, 1e6)
    world.robotctl("reset").failed(4, "the battery is at 16%, not yet at 20%")
    world.ok("sim", "set", "battery=0.21")
    assert "released" in until(lambda: world.here("reset").out)
    world.ok("stop")


@pytest.mark.slow
def test_fifty_kills_are_followed_by_fifty_starts(world: World) -> None:
    for _ in range(50):
        world.ok("start", "--sim", "--drive", "circle")
        world.kill(world.status()["pid"])
    world.ok("start", "--sim")
    world.ok("stop")
    for folder in world.recordings.iterdir():
        # Killed within its first 0.3 s, a recording is valid and empty.
        assert first_divergence(journal_of(folder)) is None


def test_a_signal_while_moving_ends_with_zero_and_a_closed_recording(world: World) -> None:
    assert "mode        MOVING" in world.ok("start", "--sim", "--drive", "circle")
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    pid = world.status()["pid"]
    os.kill(pid, signal.SIGHUP)
    until(lambda: pid not in world.processes())
    assert read_back(world.recording)["/cmd_vel"][-1].data[4:] == bytes(48)
    assert "0 dropped, 0 lost" in world.log()
    assert world.sockets() == []


def test_a_signal_during_the_start_ends_it(world: World) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
        # If another process is in the domain, a start waits some seconds for its odometry.
        somebody.bind(("127.0.0.1", 7400 + 250 * world.domain_id + 249))
        start = world.spawn("start")
        until(lambda: world.shared_memory() or start.poll() is not None)  # its node is there
        for pid, command in world.processes().items():
            if "robotctl.daemon" in command:
                os.kill(pid, signal.SIGTERM)
        _, err = start.communicate(timeout=DEADLINE_S)
    assert start.returncode != 0
    assert "stopped before it was ready" in err
    until(lambda: not world.processes())
