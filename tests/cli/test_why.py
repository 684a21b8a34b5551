"""`robotctl why`: the chain in sentences, on a terminal and for machines."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.kernel.types import ModeRequested
from robotctl.testing.drives import BEGIN_NS, Written, drive, drive_requested, record

Cli = Callable[..., Any]
FOLDER = Path("recordings/robot_20260101_120000")


@pytest.fixture(scope="module")
def stopped() -> list[Written]:
    estop = ModeRequested(BEGIN_NS + 2_000_000_000, 2, 3, "robotctl estop\x1b[2J")
    again = ModeRequested(BEGIN_NS + 2_500_000_000, 3, 1, "somebody")
    return drive(3.0, requests=[drive_requested(), estop, again])


def test_the_last_recording_is_meant_where_none_is_named(cli: Cli, stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    ran = cli("why")
    assert ran.exit_code == 0
    assert "moving is refused in EMERGENCY_STOP" in " ".join(ran.out.split())
    assert ran.out == cli("why", "last").out == cli("why", str(FOLDER)).out


def test_the_lines_fit_and_nothing_steers_the_terminal(cli: Cli, stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    out = cli("why", "--at", "2.1").out
    assert "MOVING -> EMERGENCY_STOP: requested by robotctl estop\\x1b[2J" in out
    assert "\x1b" not in out
    assert max(map(len, out.splitlines())) <= 80


def test_machines_get_the_same_as_an_object(cli: Cli, stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    found = json.loads(cli("why", "--at", "2.1", "--json").out)
    assert found["kind"] == "stop"
    assert (found["mode_before"], found["mode"]) == ("MOVING", "EMERGENCY_STOP")
    assert found["cause"] == "operator stop"
    assert found["event"].startswith("ModeRequested ")
    assert found["zero_after_ms"] >= 0.0


def test_what_cannot_be_told_has_an_exit_code(cli: Cli) -> None:
    assert cli("why").exit_code == 4
    assert cli("why", "nowhere").exit_code == 6
    record(FOLDER, drive(0.5, requests=[]))
    ran = cli("why")
    assert ran.exit_code == 4
    assert "nothing was refused" in ran.err
    assert cli("why", "--at", "noon").exit_code == 2


def test_no_ros_is_imported(stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    program = """
import sys
from robotctl.cli.app import run
assert run(["why"]) == 0
assert "rclpy" not in sys.modules
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
