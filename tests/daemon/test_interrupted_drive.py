"""A drive that a command waits for ends with the command: real processes and signals."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, World, new_world

GENTLE = f"{PATIENT}limits: {{linear_accel_mps2: 0.1, angular_accel_rps2: 0.3}}\n"
"""A ramp down from 0.3 m/s takes 3 s: there is time for a second Ctrl-C."""


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A robot that is slow to stop, for all of this module."""
    with new_world() as made:
        (made.folder / "gentle.yaml").write_text(GENTLE)
        made.ok("start", "--sim", "--config", "gentle.yaml")
        until(lambda: made.status()["pose"] is not None and made.status()["battery"] is not None)
        yield made
        made.ok("stop")


@pytest.fixture
def waiting(world: World) -> Iterator[subprocess.Popen[str]]:
    """A command that waits for an endless drive, at full speed."""
    world.robotctl("reset")
    process = world.spawn("drive", "circle", "--laps", "0", "--wait")
    until(lambda: process.poll() is not None or world.status()["velocity"]["linear"] > 0.1)
    assert process.poll() is None, process.communicate()
    yield process
    process.kill()
    process.communicate()


def stands(world: World) -> bool:
    status: Any = world.status()
    return bool(status["mode"] != "MOVING" and abs(status["velocity"]["linear"]) < 0.01)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_an_interrupted_command_returns_when_the_robot_stands(
    number: int, world: World, waiting: subprocess.Popen[str]
) -> None:
    waiting.send_signal(number)
    out, err = waiting.communicate(timeout=2 * DEADLINE_S)
    status = world.status()
    assert (waiting.returncode, status["mode"]) == (130, "IDLE")
    assert abs(status["velocity"]["linear"]) < 0.05
    assert "driven      0 laps" in out
    assert err.endswith("robotctl: Mode changed to IDLE\n"), err
    assert "requested by robotctl drive (uid" in status["mode_reason"]


def test_a_second_ctrl_c_is_the_emergency_stop(
    world: World, waiting: subprocess.Popen[str]
) -> None:
    assert waiting.stderr is not None
    waiting.send_signal(signal.SIGINT)
    assert "Ctrl-C again: emergency stop" in waiting.stderr.readline()
    until(lambda: world.status()["phase"] == "stopping")
    waiting.send_signal(signal.SIGINT)
    _, err = waiting.communicate(timeout=2 * DEADLINE_S)
    assert (waiting.returncode, world.status()["mode"]) == (130, "EMERGENCY_STOP")
    assert "release it with: robotctl reset" in err


def test_the_robot_of_a_killed_command_ramps_down(
    world: World, waiting: subprocess.Popen[str]
) -> None:
    waiting.kill()
    waiting.wait()
    until(lambda: stands(world))
    status = world.status()
    assert status["mode"] == "IDLE"
    assert "whose connection closed" in status["mode_reason"]


def test_an_emergency_stop_is_not_released_by_the_ctrl_c_that_comes_after_it(
    world: World, waiting: subprocess.Popen[str]
) -> None:
    waiting.send_signal(signal.SIGSTOP)
    world.ok("estop")
    waiting.send_signal(signal.SIGINT)
    waiting.send_signal(signal.SIGCONT)
    waiting.communicate(timeout=2 * DEADLINE_S)
    assert waiting.returncode in (4, 130)  # the end of the drive or the signal may come first
    assert world.status()["mode"] == "EMERGENCY_STOP"


def test_without_waiting_the_robot_drives_on(world: World) -> None:
    world.robotctl("reset")
    world.ok("drive", "circle", "--laps", "0")
    until(lambda: world.status()["velocity"]["linear"] > 0.1)
    assert world.status()["mode"] == "MOVING"
    world.ok("set-mode", "idle")
