"""Commands that start and end while the daemon runs, several at once, and wait for drives."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator

import pytest

from tests.support.lines import line_of
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, World, world_with_daemon


def test_a_drive_that_a_fault_ends_is_an_error_and_why_names_its_evidence(simulated: World) -> None:
    drive = simulated.spawn("drive", "square", "--wait", "--json")
    until(lambda: simulated.status()["velocity"]["linear"] > 0.1)
    simulated.ok("estop")
    out, err = drive.communicate(timeout=DEADLINE_S)
    assert drive.returncode == 4
    assert "the drive ended after 0 laps: requested by robotctl estop" in err
    found = json.loads(out)
    assert (found["laps"], found["error"]["kind"]) == (0, "refused")
    assert found["distance_m"] > 0.0
    until(lambda: simulated.robotctl("why").exit_code == 0)  # the recording holds it a moment later
    told = simulated.answer_here("why")
    assert (told["kind"], told["mode"]) == ("stop", "EMERGENCY_STOP")
    assert "a request for EMERGENCY_STOP by robotctl estop" in told["came_in"]
    assert "a square: robotctl drive" in told["asked"]
    assert told["zero_after_ms"] >= 0.0
    simulated.ok("reset")


def test_cures_of_a_named_robot_can_be_pasted_and_its_end_ends_a_waited_drive(world: World) -> None:
    r2 = ("--robot", "r2")
    world.ok("start", "--sim", *r2)
    world.ok("set-mode", "error", *r2)
    refused = world.robotctl("drive", "square", "--json", *r2)
    refused.failed(4)
    cure = refused.summary["error"]["cure"]
    assert cure == "clear it: robotctl reset --robot r2"
    assert world.answer("why", *r2)["what"].endswith(cure)
    world.ok(*cure.split("robotctl ")[1].split())
    waiting = world.spawn("drive", "circle", "--wait", *r2)
    until(lambda: world.status("r2")["mode"] == "MOVING")
    world.ok("stop", *r2)
    _, err = waiting.communicate(timeout=DEADLINE_S)
    assert waiting.returncode == 4
    assert "the drive ended after 0 laps: requested by the daemon's end" in err


def test_a_drive_while_moving_is_refused_unless_it_replaces(simulated: World) -> None:
    simulated.ok("drive", "circle", "--laps", "0")
    simulated.robotctl("drive", "square").failed(4, "--replace")
    simulated.ok("drive", "square", "--replace")
    assert simulated.status()["mode"] == "MOVING"
    simulated.ok("set-mode", "idle")


GENTLE = f"{PATIENT}limits: {{linear_accel_mps2: 0.1, angular_accel_rps2: 0.3}}\n"
"""A ramp down from 0.3 m/s takes 3 s: there is time for a second Ctrl-C."""


@pytest.fixture(scope="module")
def slow() -> Iterator[World]:
    """A robot that is slow to stop, for all of this module."""
    with world_with_daemon(settings=GENTLE) as made:
        until(lambda: made.status()["pose"] is not None and made.status()["battery"] is not None)
        yield made


@pytest.fixture
def waiting(slow: World) -> Iterator[subprocess.Popen[str]]:
    """A command that waits for an endless drive, at full speed."""
    slow.robotctl("reset")
    process = slow.spawn("drive", "circle", "--laps", "0", "--wait")
    until(lambda: process.poll() is not None or slow.status()["velocity"]["linear"] > 0.1)
    assert process.poll() is None, process.communicate()
    yield process
    process.kill()
    process.communicate()


def test_an_interrupted_command_returns_when_the_robot_stands(
    slow: World, waiting: subprocess.Popen[str]
) -> None:
    waiting.send_signal(signal.SIGINT)
    out, err = waiting.communicate(timeout=2 * DEADLINE_S)
    status = slow.status()
    assert (waiting.returncode, status["mode"]) == (130, "IDLE")
    assert abs(status["velocity"]["linear"]) < 0.05
    assert "driven      0 laps" in out
    assert err.endswith("robotctl: Mode changed to IDLE\n"), err
    assert "requested by robotctl drive (uid" in status["mode_reason"]


def test_a_second_ctrl_c_is_the_emergency_stop(slow: World, waiting: subprocess.Popen[str]) -> None:
    waiting.send_signal(signal.SIGINT)
    assert "Ctrl-C again: emergency stop" in line_of(waiting.stderr)
    until(lambda: slow.status()["phase"] == "stopping")
    waiting.send_signal(signal.SIGINT)
    _, err = waiting.communicate(timeout=2 * DEADLINE_S)
    assert (waiting.returncode, slow.status()["mode"]) == (130, "EMERGENCY_STOP")
    assert "release it with: robotctl reset" in err


def test_an_emergency_stop_is_not_released_by_the_ctrl_c_that_comes_after_it(
    slow: World, waiting: subprocess.Popen[str]
) -> None:
    waiting.send_signal(signal.SIGSTOP)
    slow.ok("estop")
    waiting.send_signal(signal.SIGINT)
    waiting.send_signal(signal.SIGCONT)
    waiting.communicate(timeout=2 * DEADLINE_S)
    assert waiting.returncode in (4, 130)  # the end of the drive or the signal may come first
    assert slow.status()["mode"] == "EMERGENCY_STOP"
